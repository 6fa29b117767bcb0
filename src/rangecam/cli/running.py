"""What commands share: opening sources and outputs, progress, the message while kernels are compiled."""

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rangecam.io import Source


def open_with_notes(source: str, preset: str | None, config: Path | None, set_: Sequence[str], seed: int) -> "Source":
    """Open a source with the settings of the command line over its own, and pass on what it has to say."""
    from rangecam.config import overrides, read_toml
    from rangecam.io import open_source

    layers = [*([read_toml(config)] if config else []), overrides(set_)]
    opened = open_source(source, preset=preset, layers=layers, seed=seed)
    for note in opened.notes:
        print(f"rangecam: note: {note}", file=sys.stderr)
    return opened


def open_sinks(stack: ExitStack, opened: "Source", targets: dict[str, Path | None]) -> Iterator[Any]:
    """Open the outputs that were asked for; the stack closes them, and on an error they leave nothing behind."""
    from rangecam import io
    from rangecam.report import Report

    makers: dict[str, Any] = {
        "record": io.Recorder,
        "report": Report,
        "images": io.ImagesWriter,
        "tracks": io.TracksWriter,
    }
    for name, path in targets.items():
        if path is not None:
            yield stack.enter_context(makers[name](path, opened.config, opened.name))


def open_stream(stack: ExitStack, url: str | None, config: Any, mode: str, link_mbit: float) -> Iterator[Any]:
    """Open the stream that was asked for, if any."""
    if url is not None:
        from rangecam.io.udp import Stream

        yield stack.enter_context(Stream(url, config, mode, link_mbit=link_mbit))


@contextmanager
def ends_on_interrupt(opened: "Source") -> Iterator[None]:
    """Let Ctrl-C end the captures of a live source, so that what was made of them is kept; a second one interrupts."""
    live = opened.live
    if live is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: Any) -> None:
        signal.signal(signal.SIGINT, before)
        live.stop()

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        live.stop()
        signal.signal(signal.SIGINT, before)


@contextmanager
def _message_if_slow(message: str, after_s: float) -> Iterator[None]:
    timer = threading.Timer(after_s, lambda: print(message, file=sys.stderr))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def warmed_up(opened: "Source", pipeline: Any) -> Iterator[Any]:
    """Yield the captures, once the kernels are compiled, so that compiling is not taken for latency."""
    for number, capture in enumerate(opened.captures):
        if number == 0:
            with _message_if_slow("rangecam: compiling kernels (on the first use only) ...", 1.5):
                pipeline.warm_up(capture, opened.config)
        yield capture


def progress(items: Any, total: int | None, what: str = "frames") -> Iterator[Any]:
    """Show progress on standard error while `items` pass, if someone is looking."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, what, total=total, console=Console(stderr=True), transient=True)
