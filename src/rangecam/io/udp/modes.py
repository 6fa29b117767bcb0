"""Which images of a frame travel (S-DBG-02), what is said beside them (S-DBG-01), and what a receiver makes of both."""

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from rangecam.config import FAMILIES, Config, load_config, preset_names, tree
from rangecam.errors import DataError, UsageError
from rangecam.io.udp.packets import text_packet
from rangecam.types import Capture, Ego, Frame, Image, RawFrame

NO_RANGE_MM = 0xFFFF
"""Marker of an invalid pixel in a range image of whole millimetres; 12500 lies within legal ranges (E-S-20)."""
HISTOGRAM_M = 0.25
"""Width of the classes of the histogram of ranges that travels with each frame."""

Planes = dict[str, Image]
Words = Mapping[str, Any]


def raw_planes(capture: Capture, frame: Frame | None, config: Config) -> Planes:
    """Return the samples as they came, of whatever family; calibration of each pixel stays at home."""
    own = getattr(FAMILIES[config.camera.kind], "PLANES", ())
    return {name: plane for name, plane in capture.raw.planes.items() if not name.startswith(tuple(own))}


def real_and_imaginary(capture: Capture, frame: Frame | None, config: Config) -> Planes:
    """Return the differences of opposite phase images: phase_0 - phase_180 and phase_270 - phase_90 (S-DST-01).

    Differences of samples of more than 15 bits need more than the 16 bits of the thesis (E-S-15).
    Raises UsageError for a camera without these four planes.
    """
    try:
        a, b, c, d = (np.asarray(capture.raw.planes[f"phase_{step}"]) for step in (0, 180, 270, 90))
    except KeyError:
        planes = ", ".join(capture.raw.planes)
        raise UsageError(f"mode real_imaginary needs four phase images; the frame holds {planes}") from None
    if a.dtype.kind == "f":
        return {"real": a - b, "imaginary": c - d}
    both = {"real": a.astype(np.int32) - b, "imaginary": c.astype(np.int32) - d}
    fits = all(np.abs(plane).max(initial=0) <= 0x7FFF for plane in both.values())
    return {name: plane.astype(np.int16) for name, plane in both.items()} if fits else both


def range_image(capture: Capture, frame: Frame | None, config: Config) -> Planes:
    """Return the cleaned range image in whole millimetres; raises UsageError where nobody has computed one."""
    if frame is None:
        raise UsageError("mode range needs range images: stream them with `rangecam run`, which computes them")
    with np.errstate(invalid="ignore"):
        millimetres = np.round(frame.image.range_m * 1e3)
        good = frame.image.valid & (millimetres >= 0) & (millimetres < NO_RANGE_MM)
    return {"range_mm": np.where(good, millimetres, NO_RANGE_MM).astype(np.uint16)}


def no_images(capture: Capture, frame: Frame | None, config: Config) -> Planes:
    """Return nothing: words alone travel."""
    return {}


def _phases(planes: Planes, config: Config) -> Planes:
    """Return four phase images with these differences, symmetric to the black level.

    What is lost with the sums: whether a sample was saturated, and how much light of a single-ended pixel was ambient.
    """
    black = np.float32(getattr(config.camera, "black_level_lsb", 0.0))
    real, imaginary = (planes[name].astype(np.float32) / 2 for name in ("real", "imaginary"))
    return {
        "phase_0": black + real,
        "phase_90": black - imaginary,
        "phase_180": black - real,
        "phase_270": black + imaginary,
    }


def _metres(planes: Planes, config: Config) -> Planes:
    millimetres = planes["range_mm"]
    return {"range_m": np.where(millimetres == NO_RANGE_MM, 0.0, millimetres / 1e3).astype(np.float32)}


def _as_they_are(planes: Planes, config: Config) -> Planes:
    return planes


@dataclass(frozen=True)
class Mode:
    """One choice of what travels.

    kind: of the camera settings that can decode it, None for that of the sender. images: of a frame.
    planes: the raw planes that a receiver makes of them.
    """

    kind: str | None
    images: Callable[[Capture, Frame | None, Config], Planes]
    planes: Callable[[Planes, Config], Planes]


MODES: dict[str, Mode] = {
    "raw": Mode(None, raw_planes, _as_they_are),
    "real_imaginary": Mode("cw", real_and_imaginary, _phases),
    "range": Mode("processed", range_image, _metres),
    "none": Mode(None, no_images, _as_they_are),
}
"""Modes by name; raw is the thesis' mode of phase images, and serves every family of cameras (K-FW-05)."""


def static_words(config: Config, mode: str, planes: Iterable[str]) -> dict[str, Any]:
    """Return what the metadata of every frame say: mode, preset, names of planes, settings that differ from the preset.

    `settings` is left out where there is no room for them: the receiver says so then.
    """
    preset, settings = config.preset, tree(config)
    if mode == "range":
        preset, camera = "generic_range", settings["camera"]
        settings = {"camera": {"lens": camera["lens"]}, "mounting": settings["mounting"]}
    if preset in preset_names():
        settings = differing(settings, tree(load_config(preset)))
    settings.get("camera", {}).pop("calibration", None)
    words: dict[str, Any] = {"mode": mode, "preset": preset, "planes": list(planes)}
    longest = {"time_s": 1e6 / 3, "frame_id": 1 << 31, **words, "settings": settings}
    with suppress(UsageError):  # it does not fit
        text_packet(longest)
        words["settings"] = settings
    return words


def differing(values: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
    """Return the nested `values` that are not the same in `base`."""
    result: dict[str, Any] = {}
    for key, value in values.items():
        old = base.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping):
            if inner := differing(value, old):
                result[key] = inner
        elif value != old:
            result[key] = value
    return result


def words_of(capture: Capture, frame: Frame | None, static: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
    """Return what goes into the four packets of text: metadata, CPU 0 with the state of the car, CPU 1, CPU 2.

    CPU 1 ranges and cleans: how many pixels are valid. CPU 2 finds objects: how many, and the histogram of ranges in
    classes of `HISTOGRAM_M`. Both are silent where nothing has been computed.
    """
    ego = capture.ego
    car = {"time_s": ego.time_s, "speed_mps": ego.speed_mps, "yaw_rate_radps": ego.yaw_rate_radps}
    zero: dict[str, Any] = {**{k: v for k, v in car.items() if v is not None and math.isfinite(v)}}
    zero["forward"] = ego.forward
    one: dict[str, Any] = {}
    two: dict[str, Any] = {}
    if frame is not None:
        decision = frame.decision
        zero |= {"brake": decision.brake, "track_id": decision.track_id}
        if math.isfinite(decision.distance_m):
            zero["distance_m"] = round(decision.distance_m, 3)
        valid = frame.image.valid
        one = {"valid_px": int(valid.sum()), "invalid_px": int(valid.size - valid.sum())}
        classes = np.minimum(frame.image.range_m[valid] / HISTOGRAM_M, 39).astype(int)
        two = {
            "segments": len(frame.segments),
            "tracks": len(frame.tracks),
            "histogram_px": np.bincount(classes).tolist(),
        }
    metadata = {"time_s": capture.raw.time_s, "frame_id": capture.raw.frame_id, **static}
    return metadata, zero, one, two


def capture_of(metadata: Words, car: Words, images: tuple[Image, ...], config: Config) -> Capture:
    """Return the capture that a received frame amounts to: the inverse of mode and words.

    Raises DataError for words that are not those of a sender of rangecam.
    """
    try:
        mode = MODES[metadata["mode"]]
        planes = dict(zip(map(str, metadata["planes"]), images, strict=True))
        raw = RawFrame(float(metadata["time_s"]), mode.planes(planes, config), int(metadata["frame_id"]))
        speed = float(car["speed_mps"]) if "speed_mps" in car else None
        time_s = float(car.get("time_s", math.nan))
        return Capture(raw, Ego(time_s, speed, float(car.get("yaw_rate_radps", 0.0)), bool(car.get("forward", True))))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DataError(f"a frame of the stream that cannot be read: {error!r}") from error


def plain_capture(time_s: float, number: int, images: Planes, config: Config) -> Capture:
    """Return the capture of a frame without words of ours: planes named by the receiver, taken at its own time."""
    planes = images
    if "range_mm" in images:
        planes = _metres(images, config)
    elif "real" in images and "imaginary" in images:
        signed = {name: images[name].view(np.int16) for name in ("real", "imaginary")}
        planes = _phases(signed, config)
    return Capture(RawFrame(time_s, planes, number))
