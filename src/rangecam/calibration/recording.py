"""What a calibration is estimated from: recordings of one camera, each of something known."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rangecam.calibration.file import Calibration, check_made_for
from rangecam.errors import UsageError
from rangecam.types import RangeImage, RawFrame


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of one camera that all saw the same.

    name: for people. camera: its settings. method, ranging: its
    ranging method, by name and as a function. known: what is known of them, in the unit of the
    step that uses it (the distance of a plane target, m; how much later the laser fired, s), None for nothing.
    """

    name: str
    frames: Iterable[RawFrame]
    camera: Any
    method: str
    ranging: Callable[[RawFrame, Any], RangeImage]
    known: float | None = None


def known_of(recording: Recording, what: str) -> float:
    """Return what is known of a recording; raises UsageError that asks for it by the name `what`."""
    if recording.known is None:
        raise UsageError(f"{recording.name}: the {what} is not said; write NUMBER={recording.name}")
    return recording.known


def begun(
    recordings: Sequence[Recording], start: Calibration, camera: Any, made_for: Callable[[Any, str], dict[str, Any]]
) -> Calibration:
    """Return the calibration so far, made for this camera; raises UsageError if it or a recording is of another.

    made_for: the facts of a camera of the family with a method.
    """
    facts = made_for(camera, recordings[0].method)
    for each in recordings[1:]:
        check_made_for(recordings[0].name, Calibration(facts), made_for(each.camera, each.method))
    if start.made_for:
        check_made_for("--from", start, facts)
    return replace(start, made_for=facts)
