"""`rangecam design`: what a camera can do, before it is built."""

import json as json_format
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rangecam.cli.app import Json, Preset, Seed, Set, app
from rangecam.cli.running import progress

if TYPE_CHECKING:
    from rangecam.config import Config

_FIRST = {"pulsed": "usercams", "cw": "scaled_car", "processed": "generic_range"}
_DEFAULT = Path("design.html")

PlanSet = Annotated[
    list[str],
    Parameter(
        name="--plan",
        negative=(),
        show_default=False,
        help="One setting of the experiment, key=value, such as accuracy=0.02, distances_m=[5,20], ambient_wpm2=30.",
    ),
]
Output = Annotated[
    Path | None,
    Parameter(name=["--output", "-o"], help="HTML page that opens offline; design.html unless --json is given."),
]


@app.command
def design(
    *cameras: str,
    preset: Preset = None,
    config: Annotated[
        list[Path], Parameter(name="--config", negative=(), help="TOML file of a camera; as CAMERAS.")
    ] = [],  # noqa: B006 (cyclopts reads the default, nobody changes it)
    set_: Set = [],  # noqa: B006 (as above)
    plan: PlanSet = [],  # noqa: B006 (as above)
    output: Output = None,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Judge CAMERAS (TOML files or presets; several are compared): accuracy over range, limits and what sets them."""
    from rangecam import design as designs
    from rangecam.config import overrides, parse
    from rangecam.io.files import check_target, replacing

    path = output or (None if json else _DEFAULT)
    target = None if path is None else check_target(path)
    planned = parse(designs.Plan, overrides(plan), "--plan")
    names = [*cameras, *map(str, config)] or [preset or "usercams"]
    chosen = [(Path(name).stem, _configured(name, preset, set_)) for name in names]
    judged = [designs.judge(name, one, planned, seed) for name, one in progress(chosen, len(chosen), "designs")]
    if target is not None:
        with replacing(target) as part:
            part.write_bytes(designs.html(judged))
    if json:
        print(json_format.dumps({"designs": [designs.as_json(one) for one in judged]}, allow_nan=False))
    else:
        print(designs.describe(judged))
        print(f"report     {target}")


def _configured(name: str, preset: str | None, set_: Sequence[str]) -> "Config":
    """Return the configuration of a camera: a preset, or a TOML file over a preset of its family."""
    from rangecam.config import load_config, overrides, preset_names, read_toml

    if name in preset_names() and not Path(name).is_file():
        return load_config(name, overrides(set_))
    layer = read_toml(name)
    kind = str(layer.get("camera", {}).get("kind", ""))
    first = preset or layer.get("preset") or _FIRST.get(kind, "usercams")
    return load_config(str(first), layer, overrides(set_))
