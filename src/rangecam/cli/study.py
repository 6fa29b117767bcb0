"""`rangecam study`: the experiments of the theses."""

import json as json_format
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from rangecam.cli.app import Json, Seed, app
from rangecam.cli.running import progress
from rangecam.errors import UsageError


@app.command
def study(
    name: str | None = None,
    /,
    *,
    folder: Annotated[Path, Parameter(help="Where the figures go, NAME.png.")] = Path(),
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Repeat the experiments of the theses: NAME (table and NAME.png) or all (studies.html); without a name, list."""
    from rangecam import studies
    from rangecam.io.files import check_target, replacing

    if name is None and not json:
        print(studies.study_list())
        return
    if name is None:
        raise UsageError(f"study --json needs a name: {', '.join([*studies.STUDIES, 'all'])}")
    names = studies.study_names(name)
    path = None if json else check_target(folder / ("studies.html" if name == "all" else f"{name}.png"))
    results = [studies.run_study(one, seed) for one in progress(names, len(names), "studies")]
    if path is None:
        print(json_format.dumps(studies.as_json(results)))
        return
    with replacing(path) as part:
        part.write_bytes(_study_page(results) if name == "all" else studies.draw(results[0]))
    print(studies.verdicts(results) if name == "all" else studies.table(results[0]))
    print(f"{'report' if name == 'all' else 'figure'}     {path}")


def _study_page(results: Sequence[Any]) -> bytes:
    """Return one page with the figure and the claims of every study."""
    from rangecam import studies
    from rangecam.report.template import page, section

    lead = "What the theses state beside what this program computes; where they differ, the reason."
    parts = [section(one.name, one.section, studies.draw(one), studies.table(one)) for one in results]
    return page("The experiments of the theses", lead, studies.verdicts(results), parts).encode("utf-8")
