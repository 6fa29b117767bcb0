"""What a camera reads while nothing changes, above all in darkness."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rangecam.errors import DataError
from rangecam.types import Floats, Ints, RawFrame


class Still(NamedTuple):
    """What frames of one and the same say of each pixel, by number of accumulations.

    accumulations, frames (K,): the numbers, and how many frames there were of each. mean, variance: plane ->
    (K, H, W); the variance is that of a single frame, NaN where there is but one.
    """

    accumulations: Ints
    frames: Ints
    mean: dict[str, Floats]
    variance: dict[str, Floats]


def estimate_dark(frames: Iterable[RawFrame], prefix: str) -> Still:
    """Return mean and variance of the planes that begin with `prefix`, of frames taken without any light.

    Some of each number of accumulations (n_acc, the same for all pixels of a frame; 1 where a camera does not
    accumulate); what their mean leaves of the noise stays in every range, so take many. König 2008, 4.3.1 (K-CAL-01).
    Frames of a scene that stands still will do for a camera that does not accumulate. Raises DataError for no frames,
    frames without such planes or of different shapes or planes, or one whose pixels differ in n_acc: it was not dark.
    """
    sums: dict[int, list[Floats]] = {}
    names: list[str] = []
    shape: tuple[int, ...] = ()
    for raw in frames:
        found = [name for name in raw.planes if name.startswith(prefix)]
        if not found or (names and (found, raw.shape) != (names, shape)):
            raise DataError(
                f"frame {raw.frame_id}: a dark frame needs {', '.join(names) or prefix + '*'} planes of the same shape "
                f"as those before it; it has {[*raw.planes]} of {raw.shape}"
            )
        names, shape = found, raw.shape
        images = np.stack([np.asarray(raw.planes[name], np.float64) for name in names])
        entry = sums.setdefault(_accumulations(raw), [np.zeros(()), images, 0 * images, 0 * images])
        # sums of the differences to the first frame: those of the values would lose the digits of the variance
        entry[0], entry[2], entry[3] = entry[0] + 1, entry[2] + images - entry[1], entry[3] + (images - entry[1]) ** 2
    if not sums:
        raise DataError("no dark frames: at least one is needed")
    accumulations: Ints = np.array(sorted(sums), np.int64)
    means, variances = [], []
    for count, first, one, two in (sums[n] for n in accumulations):
        means.append(first + one / count)
        variances.append((two - one**2 / count) / (count - 1) if count > 1 else np.full(one.shape, np.nan))
    stacks = ({name: np.stack([each[i] for each in images]) for i, name in enumerate(names)}
              for images in (means, variances))  # fmt: skip
    return Still(accumulations, np.array([int(sums[n][0]) for n in accumulations], np.int64), *stacks)


def _accumulations(raw: RawFrame) -> int:
    """Return the number of accumulations of a dark frame."""
    steps = np.unique(raw.planes["n_acc"]) if "n_acc" in raw.planes else np.ones(1)
    if len(steps) != 1:
        raise DataError(
            f"frame {raw.frame_id}: its pixels have n_acc = {', '.join(f'{n:g}' for n in steps)}; in darkness and "
            "with one number of accumulations at a time they would all have the same"
        )
    return int(steps[0])
