"""What goes wrong, said to people: what was wrong, where, and what would be right.

The command line turns a RangecamError into one line on standard error and an exit code.
"""

import difflib
from collections.abc import Iterable


class RangecamError(Exception):
    """The base of every error that rangecam raises on purpose; `exit_code` is what the command line returns."""

    exit_code = 1


class DataError(RangecamError):
    """The data is at fault: a broken file, samples of the wrong shape, a recording without frames (exit code 1)."""


class UsageError(RangecamError):
    """The call is at fault: an unknown preset, a misspelled setting, an impossible value (exit code 2)."""

    exit_code = 2


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" for the nearest of the known names, or an empty string."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""
