"""Addresses of streams: udp://HOST:PORT?key=value."""

import math
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

from rangecam.errors import UsageError, did_you_mean

LOOPBACK = "127.0.0.1"
KEYS = {"wait": "s", "idle": "s", "planes": "names", "rows": "number", "columns": "number"}


@dataclass(frozen=True)
class Address:
    """Where a stream goes to or is awaited, and how.

    wait_s: for the first frame. idle_s: without any packet, after which the stream has ended. planes: names of the
    images of a sender without our checksums, with their size (rows, columns); none: the sender is rangecam.
    """

    host: str
    port: int
    wait_s: float = 10.0
    idle_s: float = 2.0
    planes: tuple[str, ...] = ()
    shape: tuple[int, int] = (120, 160)


def parse_address(url: str) -> Address:
    """Return the address of udp://HOST:PORT, with ?wait=S&idle=S&planes=A,B,..&rows=N&columns=N behind it.

    Without a host it is this machine itself. Raises UsageError for anything else.
    """
    parts = urlsplit(url)
    try:
        port = parts.port
    except ValueError:
        port = None
    if parts.scheme != "udp" or port is None or parts.path not in ("", "/"):
        raise UsageError(f"{url}: expected udp://HOST:PORT, for example udp://{LOOPBACK}:5005")
    values = dict(parse_qsl(parts.query, keep_blank_values=True))
    for key in values:
        if key not in KEYS:
            raise UsageError(f"{url}: unknown '{key}'{did_you_mean(key, KEYS)}; known are {', '.join(KEYS)}")
    usual = Address(LOOPBACK, port)
    return Address(
        parts.hostname or LOOPBACK,
        port,
        _number(url, values, "wait", usual.wait_s),
        _number(url, values, "idle", usual.idle_s),
        tuple(name for name in values.get("planes", "").split(",") if name),
        (
            int(_number(url, values, "rows", usual.shape[0], 1)),
            int(_number(url, values, "columns", usual.shape[1], 1)),
        ),
    )


def _number(url: str, values: dict[str, str], key: str, usual: float, least: float = 0.0) -> float:
    text = values.get(key, str(usual))
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not least <= number < 1e6:
        raise UsageError(f"{url}: {key}={text}: expected a number of at least {least:g}")
    return number
