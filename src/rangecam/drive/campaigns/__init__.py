"""Campaigns: thousands of drives, each drawn from its own seed, on as many processors as there are.

- trial: one drive before it is driven; scaled_car, full_size, false_positives: how one is drawn
- row: one drive and what an ideal system makes of it, as a row of the table
- run: the table, which goes on where it was cut off
- statistics, figures, page: what it comes to
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rangecam.drive.campaigns import false_positives, full_size, scaled_car
from rangecam.drive.campaigns.trial import Trial
from rangecam.errors import UsageError, did_you_mean

CAMPAIGNS: dict[str, Callable[[np.random.Generator, int, Mapping[str, Any]], Trial]] = {
    "scaled-car": scaled_car.draw,
    "full-size": full_size.draw,
    "false-positives": false_positives.draw,
}
"""How a drive of each campaign is drawn: (rng, seed of its noise, the user's settings) -> Trial."""


def trial_of(campaign: str, seed: int, number: int, layers: Mapping[str, Any]) -> Trial:
    """Return drive `number` of a campaign, which depends on `seed` and `number` alone.

    layers: settings of the user over those of every camera. Raises UsageError for an unknown campaign.
    """
    if campaign not in CAMPAIGNS:
        known = ", ".join(CAMPAIGNS)
        raise UsageError(f"unknown campaign '{campaign}'{did_you_mean(campaign, CAMPAIGNS)}; campaigns: {known}")
    kind = list(CAMPAIGNS).index(campaign)
    sequence = np.random.SeedSequence([seed, kind, number])
    return CAMPAIGNS[campaign](np.random.default_rng(sequence), int(sequence.generate_state(1)[0]), layers)
