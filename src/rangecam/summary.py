"""What a run says of itself: the JSON of `rangecam run --json` and the lines that people read."""

import hashlib
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from rangecam.config import Config
from rangecam.metrics import honesty, quality_of, scored
from rangecam.metrics.quality import Scored
from rangecam.types import CLASSES, Capture, Decision, Floats, Frame, Refused, Track, TrackStatus


class Stopwatch:
    """A `step` for `process_frame` that keeps the seconds each stage took."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[str, list[float]] = {}
        self._clock = clock

    def __call__(self, stage: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call `function` and note how long it took."""
        start = self._clock()
        result = function(*arguments)
        self.seconds.setdefault(stage, []).append(self._clock() - start)
        return result

    def latency_ms(self) -> dict[str, dict[str, float]]:
        """Return p50, p99 and max of each stage and of their sum, in milliseconds."""
        columns = dict(self.seconds)
        if columns:
            columns["sum"] = [sum(row) for row in zip(*self.seconds.values(), strict=True)]
        return {stage: _quantiles_ms(seconds) for stage, seconds in columns.items()}


def _quantiles_ms(seconds: list[float]) -> dict[str, float]:
    p50, p99, top = np.percentile(seconds, [50, 99, 100]) * 1e3
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4), "max": round(float(top), 4)}


class Summary:
    """A sink that gathers what a run found; `result` is made of JSON values only."""

    def __init__(self, source: str, config: Config) -> None:
        self._source, self._config = source, config
        self._times: list[float] = []
        self._valid: list[float] = []
        self._segments: list[int] = []
        self._events: list[dict[str, Any]] = []
        self._braking = False
        self._brake_frames = 0
        self._tracks: dict[int, dict[str, Any]] = {}
        self._refused: dict[Refused, int] = {each: 0 for each in Refused if each != Refused.NOTHING}
        self._ignored = 0
        self._nis: list[Floats] = []
        self._scored: list[Scored] = []
        self._digest = hashlib.sha256()

    def write(self, capture: Capture, frame: Frame) -> None:
        """Take in one frame."""
        decision = frame.decision
        self._times.append(decision.time_s)
        self._valid.append(float(frame.image.valid.mean()))
        self._segments.append(len(frame.segments))
        self._brake_frames += decision.brake
        if decision.brake != self._braking or not self._events:
            self._events.append(_event(decision))
        self._braking = decision.brake
        tracks, threats = frame.tracks, decision.collisions
        if tracks.refused:
            self._refused[Refused(tracks.refused)] += 1
        if tracks.refused not in (Refused.REPEATED, Refused.LATE):  # else they are those of the frame before
            self._ignored += tracks.ignored
            self._nis.append(tracks.nis[tracks.status == TrackStatus.CONFIRMED])
        if (against_truth := scored(capture, frame, self._config)) is not None:
            self._scored.append(against_truth)
        for values in (
            tracks.track_id,
            tracks.status,
            tracks.state,
            tracks.covariance,
            threats.ttc_s,
            threats.p_collision,
        ):
            self._digest.update(np.ascontiguousarray(values).tobytes())
        self._digest.update(f"{decision.brake} {decision.reason}".encode())
        for track in frame.tracks:
            if track.status == TrackStatus.TENTATIVE:
                continue
            known = self._tracks.setdefault(
                track.track_id,
                {"track_id": track.track_id, "first_s": decision.time_s, "frames": 0, "nearest_m": math.inf},
            )
            best = int(np.argmax(track.class_probability))
            known |= {
                "last_s": decision.time_s,
                "frames": known["frames"] + 1,
                "nearest_m": min(known["nearest_m"], float(track.position_m[0] - track.near_offset_m)),
                "position_m": [round(float(v), 4) for v in track.position_m],
                "velocity_mps": [round(float(v), 4) for v in track.velocity_mps],
                "size_m": [round(float(v), 3) for v in track.size_m],
                "class": CLASSES[best],
                "p_class": round(float(track.class_probability[best]), 4),
                "action": track.action_name,
                "p_action": _p_action(track),
            }

    def close(self) -> None:
        """Nothing to close."""

    def result(self, watch: Stopwatch) -> dict[str, Any]:
        """Return the summary as JSON values; `digest` is equal if and only if every track and decision was.

        `refused` counts frames that were repeated or late, and how often the clock was set back, `ignored_segments`
        those of no finite position. `nis` is whether the innovations of the confirmed tracks are as large as they
        should be: see `metrics.honesty`;
        `quality` is there where the truth is known: see `metrics.quality_of`.
        """
        from rangecam import __version__

        span = self._times[-1] - self._times[0] if self._times else 0.0
        return {
            "source": self._source,
            "preset": self._config.preset,
            "camera": {
                "name": self._config.camera.name,
                "kind": self._config.camera.kind,
                "ranging": self._config.ranging,
                "segmentation": self._config.segmentation,
            },
            "frames": len(self._times),
            "duration_s": round(span, 6),
            "valid_fraction": round(float(np.mean(self._valid)), 6) if self._valid else 0.0,
            "segments_per_frame": self._segments,
            "tracks": list(self._tracks.values()),
            "decisions": {"brake_frames": self._brake_frames, "events": self._events},
            "refused": {each.name.lower(): number for each, number in self._refused.items()},
            "ignored_segments": self._ignored,
            "nis": honesty(np.concatenate([np.zeros(0), *self._nis])),
            **({"quality": quality_of(self._scored)} if self._scored else {}),
            "latency_ms": watch.latency_ms(),
            "digest": self._digest.hexdigest(),
            "version": __version__,
        }


def _p_action(track: Track) -> float | None:
    return None if track.action_probability is None else round(float(track.action_probability.max()), 4)


def _event(decision: Decision) -> dict[str, Any]:
    values = {
        "time_s": decision.time_s,
        "brake": decision.brake,
        "reason": decision.reason,
        "track_id": decision.track_id,
        "distance_m": decision.distance_m,
        "closing_speed_mps": decision.closing_speed_mps,
        "stopping_distance_m": decision.stopping_distance_m,
        "ttc_s": decision.ttc_s,
        "p_collision": decision.p_collision,
    }
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def describe(result: dict[str, Any]) -> str:
    """Return the summary as lines for people."""
    camera, tracks = result["camera"], result["tracks"]
    events = [event for event in result["decisions"]["events"] if event["brake"]]
    brakes = [f"brake      at {event['time_s']:.2f} s: {event['reason']}" for event in events]
    lines = [
        f"{result['source']}: {count(result['frames'], 'frame')} in {result['duration_s']:.2f} s",
        f"camera     {camera['name']} ({camera['kind']}), preset {result['preset']}",
        f"methods    {camera['ranging']}, {camera['segmentation']}",
        f"pixels     {100 * result['valid_fraction']:.1f} % valid on average",
        f"objects    {count(len(tracks), 'confirmed track')}",
        *_first([_describe_track(track) for track in tracks], 8),
        *(_first(brakes, 5) or ["brake      never"]),
        *_describe_honesty(result["nis"]),
        *_describe_quality(result.get("quality")),
        *_describe_refused(result["refused"], result["ignored_segments"]),
        *_describe_received(result.get("received")),
    ]
    if "sum" in result["latency_ms"]:
        total = result["latency_ms"]["sum"]
        lines.append(f"speed      {total['p50']:.2f} ms from raw samples to decision (99 %: {total['p99']:.2f} ms)")
    return "\n".join(lines)


def count(number: int, what: str) -> str:
    """Return a number of things, in the singular where it is one."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _describe_track(track: dict[str, Any]) -> str:
    seen = f"{track['first_s']:.2f}-{track['last_s']:.2f} s"
    what = f"{track['class']}, {track['action']}" if track["action"] else track["class"]
    return f"           #{track['track_id']} {what}: {seen}, nearest {track['nearest_m']:.2f} m"


def _describe_honesty(nis: dict[str, Any] | None) -> list[str]:
    """Return how large the innovations are beside what they should be, if any track was confirmed."""
    if nis is None:
        return []
    low, high = nis["bounds"]
    verdict = "as it should be" if low <= nis["mean"] <= high else f"expected {low:.2f} to {high:.2f}"
    return [f"NIS        {nis['mean']:.2f} on average, {verdict}; {100 * nis['inside']:.0f} % within their bounds"]


def _describe_quality(quality: dict[str, Any] | None) -> list[str]:
    """Return what the truth says of the tracks, if any object of it was followed."""
    if quality is None or quality["rmse_position_m"] is None:
        return []
    errors = f"{quality['rmse_position_m']:.3f} m, {quality['rmse_velocity_mps']:.3f} m/s"
    scores = f"MOTA {quality['clear']['mota']:.2f}, HOTA {quality['hota']['hota']:.2f}"
    return [f"truth      RMS error {errors}; {scores}"]


def _describe_refused(refused: dict[str, int], ignored: int) -> list[str]:
    """Return what of the input was not used, if anything."""
    texts = {
        "repeated": count(refused["repeated"], "repeated frame"),
        "late": count(refused["late"], "late frame"),
        "clock_set_back": f"clock set back {count(refused['clock_set_back'], 'time')}",
    }
    said = [text for name, text in texts.items() if refused[name]]
    said += [f"{count(ignored, 'segment')} of no finite position"] if ignored else []
    return [f"not used   {', '.join(said)}"] if said else []


def _describe_received(counts: dict[str, int] | None) -> list[str]:
    """Return what came of a stream and what of it was lost, if it was one."""
    if counts is None:
        return []
    lost = {name: counts[name] for name in ("incomplete", "skipped", "unreadable")}
    said = ", ".join(f"{number} {name}" for name, number in lost.items() if number) or "none lost"
    strangers = f"; {counts['unexpected']} packets of no frame" if counts["unexpected"] else ""
    missing = f" ({counts['missing']} packets missing)" if counts["missing"] else ""
    return [f"stream     {count(counts['frames'], 'complete frame')}, {said}{missing}{strangers}"]


def _first(lines: list[str], most: int) -> list[str]:
    return lines if len(lines) <= most else [*lines[:most], f"           ... and {len(lines) - most} more"]
