"""`rangecam train`: the trees of the learned classifier, from simulated drives, and how good they are on others."""

import json as json_format
import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rangecam.cli.app import Json, app
from rangecam.cli.running import progress


@app.command
def train(
    model: Annotated[Path | None, Parameter(help="Where the new model goes (.npz); none: only score.")] = None,
    *,
    drives: Annotated[int, Parameter(help="Drives of each sensor to learn from.")] = 2000,
    held_out: Annotated[int, Parameter(help="Other drives of each sensor to score with.")] = 150,
    rounds: Annotated[int, Parameter(help="Rounds of growing, of one tree for each class.")] = 300,
    seed: Annotated[int, Parameter(help="Seed of the drives.")] = 1,
    jobs: Annotated[int | None, Parameter(help="Processes to work in; otherwise as many as there are cores.")] = None,
    json: Json = False,
) -> None:
    """Train the classifier on simulated drives and write MODEL, then score it, or the one that ships, on others.

    As a whole it takes tens of minutes on two cores. Resolved: at 2 to 15 m, at least 4 by 4 pixels, not cut short
    beside, not in pieces. Right of all counts what stays unknown as wrong.
    """
    from rangecam.classify.learned import load_model, save_model
    from rangecam.io.files import check_target, replacing
    from rangecam.training.fit import fit
    from rangecam.training.lots import learning_lots, scores, simulate
    from rangecam.tuning import mapping, workers

    target = None if model is None else check_target(model)
    with workers(jobs or os.cpu_count() or 1) as executor:
        over = mapping(executor, partial(progress, what="drives"))
        if target is not None:
            examples = simulate(learning_lots(drives, seed), over)
            with replacing(target) as part:
                save_model(fit(examples, seed, rounds), part)
        scored = scores(load_model("" if target is None else str(target)), held_out, seed, over)
    if json:
        print(json_format.dumps({"model": None if model is None else str(model), "scores": scored}, allow_nan=False))
    else:
        for name, one in scored.items():
            print(_described(name, one))


def _described(name: str, score: dict[str, Any]) -> str:
    clear = score["resolved"]
    return (
        f"{name:22} {_percent(clear['right_of_all'])} right of what is resolved ({clear['examples']} of "
        f"{score['examples']} examples; {_percent(clear['right'])} of the {_percent(clear['decided'])} decided), "
        f"{_percent(score['right_of_all'])} right of all ({_percent(score['right'])} of the "
        f"{_percent(score['decided'])} decided), probabilities off by {_percent(score['calibration_error'])}"
    )


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"
