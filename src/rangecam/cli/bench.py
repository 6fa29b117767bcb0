"""`rangecam bench`: milliseconds beside peers."""

import json as json_format
from typing import Annotated

from cyclopts import Parameter

from rangecam.cli.app import Json, app


@app.command
def bench(*, seconds: Annotated[float, Parameter(help="Time spent on each row.")] = 2.0, json: Json = False) -> None:
    """Measure milliseconds a stage and a chain, beside peers in the same process (extra: rangecam[bench])."""
    from rangecam.bench import measure, table

    result = measure(seconds)
    print(json_format.dumps(result) if json else table(result))
