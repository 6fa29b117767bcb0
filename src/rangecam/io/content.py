"""What an opener finds in a source, and what `open_source` makes of it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from rangecam.config import Config
from rangecam.types import Capture


class Live(Protocol):
    """What goes on while the captures of a live source are used."""

    def stop(self) -> None:
        """End the captures after those that have come; may be called from a signal handler."""

    def counts(self) -> dict[str, int]:
        """Return how many frames and packets came, and what was lost."""


@dataclass(frozen=True, eq=False)
class Content:
    """What a source holds, before the settings to decode it with are settled.

    what: its samples, in words. kind: of the camera settings that can decode them, None for any.
    preset: the one to decode it with unless another is asked for. settings: complete ones that came with the source
    and are used instead of the preset's. facts: settings that the source itself states; they win over any preset.
    captures, n_frames: its frames under a configuration, and how many (None: not known).
    notes: what people should know about it. live: what it is received by, None for what is already there.
    """

    what: str
    kind: str | None
    preset: str
    captures: Callable[[Config], Iterator[Capture]]
    n_frames: Callable[[Config], int | None]
    settings: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    live: Live | None = None


@dataclass(frozen=True, eq=False)
class Captures:
    """The captures of a source; every iteration begins with the first one."""

    begin: Callable[[], Iterator[Capture]]

    def __iter__(self) -> Iterator[Capture]:
        return self.begin()


@dataclass(frozen=True, eq=False)
class Source:
    """An opened source: captures, and the configuration that they are to be processed with.

    name: the URL it was opened by. n_frames: None where nobody knows. notes: what people should know about it.
    live: what it is received by, None for what is already there.
    """

    name: str
    config: Config
    captures: Captures
    n_frames: int | None = None
    notes: tuple[str, ...] = ()
    live: Live | None = None
