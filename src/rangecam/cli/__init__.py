"""The command line, thin: a module for each command, which opens a source, lets the library work and prints.

Nothing heavy is imported before it is needed, so that `rangecam --help` answers at once. An error is one line on
standard error; exit code 1 for data, 2 for the call. A new command is a module here and a name in COMMANDS.
"""

import sys
from collections.abc import Sequence
from importlib import import_module

from cyclopts import CycloptsError

from rangecam.cli.app import app
from rangecam.errors import RangecamError

COMMANDS = (
    "demo",
    "run",
    "simulate",
    "calibrate",
    "design",
    "study",
    "tune",
    "train",
    "drive",
    "bench",
    "repair",
    "can",
)
"""Modules of this package, one a command; importing one registers it."""

for _name in COMMANDS:
    import_module(f"{__name__}.{_name}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done, 1 the data or a check failed, 2 the call was wrong."""
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in tokens
    tokens = [token for token in tokens if token != "--debug"]
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except RangecamError as error:
        return _fail(error, str(error), error.exit_code, debug)
    except CycloptsError as error:
        return _fail(error, str(error), 2, debug)
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        return _fail(None, "interrupted", 130, False)
    except OSError as error:
        return _fail(error, f"{error.filename or 'input or output'}: {error.strerror or error}", 1, debug)
    except Exception as error:  # the last line of defence: no traceback for users, but nothing hidden from --debug
        message = f"internal error: {type(error).__name__}: {error} (run again with --debug and report it)"
        return _fail(error, message, 1, debug)
    return 0


def _fail(error: BaseException | None, message: str, code: int, debug: bool) -> int:
    if debug and error is not None:
        raise error
    print("rangecam: " + " ".join(message.split()), file=sys.stderr)
    return code
