"""The report as a sink: it keeps a little of every frame and all of the most telling one."""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rangecam.config import Config
from rangecam.io.files import check_target, replacing
from rangecam.report import figures
from rangecam.report.template import page, section
from rangecam.summary import Stopwatch, Summary, describe
from rangecam.types import Capture, Frame, Tracks, TrackStatus


class Report:
    """Writes the page when it is closed without an error; an error leaves no file behind.

    The frame whose life is shown is the first that braked, else the one with most confirmed tracks, then segments, then
    pixels in them.
    """

    def __init__(self, path: Path | str, config: Config, source: str = "") -> None:
        self._path, self._config, self._source = check_target(path, source), config, source
        self._summary, self._watch = Summary(source, config), Stopwatch()
        self._before = Tracks.empty()
        self._best: tuple[tuple[int, int, int, int], Capture, Tracks] | None = None
        self._timeline: list[figures.Moment] = []
        self._trails: dict[int, list[tuple[float, float]]] = {}
        self._classes: dict[int, str] = {}

    def write(self, capture: Capture, frame: Frame) -> None:
        """Take in one frame."""
        self._summary.write(capture, frame)
        confirmed = [track for track in frame.tracks if track.status != TrackStatus.TENTATIVE]
        pixels = int(frame.segments.n_pixels.sum())
        score = (int(frame.decision.brake), len(confirmed), len(frame.segments), pixels)
        if self._best is None or (score > self._best[0] and not self._best[0][0]):
            self._best = score, capture, self._before
        self._before = frame.tracks
        for track in confirmed:
            x, y = float(track.position_m[0]), float(track.position_m[1])
            self._trails.setdefault(track.track_id, []).append((x, y))
            self._classes[track.track_id] = f"{track.class_name}, {track.action_name}"
        self._timeline.append(figures.moment(frame, capture.ego))

    def close(self) -> None:
        """Draw the figures and write the page at once, so that nobody ever sees half of it."""
        if self._best is None:
            return
        from rangecam.pipeline import process_frame

        _, capture, tracks = self._best
        life = figures.LifeOfAFrame()
        frame = process_frame(capture.raw, tracks, capture.ego, self._config, life)
        summary = describe(self._summary.result(self._watch))
        sections = [section(*parts) for parts in self._sections(frame, life)]
        with replacing(self._path) as part:
            part.write_text(page(self._source, self._config.description, summary, sections), encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()

    def _sections(self, frame: Frame, life: Any) -> list[tuple[str, str, str]]:
        """Return (title, text, picture) of each section."""
        config, time_s = self._config, frame.image.time_s
        return [
            (
                f"What the camera measured at {time_s:.2f} s",
                "Amplitude, radial range, its standard deviation from the noise model (grey: no valid range), and why "
                "pixels are refused, by ranging or by the cleaning that follows.",
                figures.images(life.before_cleaning(), frame.image, config.camera.lens),
            ),
            (
                "The life of this frame",
                "Raw samples, ranging, every cleaning step, segments: what each stage changed.",
                figures.life(life, frame, config),
            ),
            (
                "Segments and tracks from above",
                "Points of the frame above, coloured by segment; trails of all confirmed tracks of the run with their "
                "number; ellipses hold two standard deviations. The vehicle is at the origin and looks to the right.",
                figures.from_above(frame, life, self._trails, self._classes, config),
            ),
            (
                "Time to collision and brake",
                "The track that decides at each moment: free way against stopping distance, speeds, time to collision "
                "with two standard deviations. Red: the rule demands braking (here the vehicle does not obey).",
                figures.timeline(self._timeline, config.decision.margin),
            ),
        ]
