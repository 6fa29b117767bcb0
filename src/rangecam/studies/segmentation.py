"""The methods of segmentation beside each other, on the same simulated scenes, whose truth knows each pixel's object.

People beside and behind each other, before a wall, a wall seen askew, a box on the floor, people who cross, more noise.
`rangecam bench` times the methods.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rangecam.cameras.simulated import frames
from rangecam.config import Config, load_config
from rangecam.pipeline import process_frame
from rangecam.scene.paths import Path
from rangecam.scene.scenario import Scenario
from rangecam.scene.shapes import Box, SceneObject
from rangecam.segmentation import SEGMENTATION
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.types import Floats, Ints, Tracks

_SECTIONS = {"region_growing": "K-SEG-03", "range_histogram": "S-SEG-04"}  # the others are alternatives, S-SEG-05
_GAPS_M = (0.1, 0.2, 0.4, 0.8)
_WALLS_M = (0.3, 0.6, 1.2, 2.4)
_INCIDENCE_DEG = (30.0, 50.0, 70.0)
_READ_NOISE_LSB = (2.0, 15.0, 30.0)
_PART = 0.1  # of the pixels of an object: less of it in a segment is the noise of an edge
_LEAST_PIXELS = 8


class Score(NamedTuple):
    """Mean over the objects: whether it fell into several segments, shares one with another, overlap over union."""

    over: float
    under: float
    iou: float


class Case(NamedTuple):
    """Scenes of one kind, each at a value of what is varied: (value, scenario, read noise)."""

    name: str
    label: str
    scenes: tuple[tuple[float, Scenario, float], ...]


def segmentation(rng: np.random.Generator) -> Study:
    """The methods of segmentation beside each other: what falls apart, what merges, overlap with the truth."""
    seed, cases = int(rng.integers(2**20)), list(_cases())
    claims, panels = list[Claim](), list[Panel]()
    found: dict[str, dict[str, list[Score]]] = {method: {} for method in SEGMENTATION}
    for case in cases:
        for method in SEGMENTATION:
            found[method][case.name] = [_score(scene, noise, method, seed) for _, scene, noise in case.scenes]
        values = [value for value, _, _ in case.scenes]
        series = [Series(name, values, [s.iou for s in found[name][case.name]], None, "o-") for name in SEGMENTATION]
        panels.append(Panel(case.name, case.label, "overlap over union", series))
    for method, of in found.items():
        number = _SECTIONS.get(method, "S-SEG-05")
        for case in cases:
            over, under, iou = np.mean(of[case.name], axis=0)
            text = f"{method}, {case.name}"
            claims.append(derived(number, f"{text}: objects in several segments", float(over), ""))
            claims.append(derived(number, f"{text}: objects that share one with another", float(under), ""))
            claims.append(derived(number, f"{text}: overlap over union", float(iou), ""))
    claims += _judgements(found)
    rates = [
        Series(kind, np.arange(len(found)), [np.mean([getattr(s, field) for c in of.values() for s in c])
                                             for of in found.values()], None, "o")
        for kind, field in (("in several segments", "over"), ("share one with another", "under"))
    ]  # fmt: skip
    names = ", ".join(f"{k} {name}" for k, name in enumerate(found))
    panels.append(Panel("All scenes", names, "share of the objects", rates))
    return Study("segmentation", "König 2008, 6.3; Steinbäck 2016, 2.3.2 and 4.5.3", claims, panels)


def _judgements(found: dict[str, dict[str, list[Score]]]) -> list[Claim]:
    beside = found["range_histogram"]["two people beside each other"]
    askew = found["region_growing_3d"]["a wall seen askew"]
    apart = found["region_growing"]["one person behind another"][-1]
    merged, whole = float(np.mean([s.under for s in beside])), float(np.mean([s.over for s in askew]))
    text = "range_histogram: people at one distance who share a segment, whatever the gap"
    why = "the thesis: objects at the same distance become one"
    return [
        judged("S-SEG-04", text, None, merged, "", merged == 1.0, why),
        judged("S-SEG-05", "region_growing_3d: walls askew that fall apart", None, whole, "", whole == 0.0,
               "up to 70 degrees, of the 80 that it joins to"),
        judged("K-SEG-03", "region_growing: people 2.4 m behind each other who share a segment", None, apart.under, "",
               apart.under == 0.0, "four times the threshold of 0.6 m"),
    ]  # fmt: skip


def _cases() -> Iterator[Case]:
    quiet = _READ_NOISE_LSB[0]
    yield Case("two people beside each other", "gap between them / m, at 4, 8 and 12 m in turn", tuple(
        (gap + 0.01 * k, _scene(_person("one", away, (gap + 0.5) / 2), _person("other", away, -(gap + 0.5) / 2)), quiet)
        for gap in _GAPS_M for k, away in enumerate((4.0, 8.0, 12.0))
    ))  # fmt: skip
    yield Case("one person behind another", "how far behind / m", tuple(
        (far, _scene(_person("one", 6.0, 0.15), _person("other", 6.0 + far, -0.15)), quiet) for far in _WALLS_M
    ))  # fmt: skip
    yield Case("a person before a wall", "how far before it / m", tuple(
        (far, _scene(_person("one", 6.0, 0.0), _wall(6.0 + far, 90.0)), quiet) for far in _WALLS_M
    ))  # fmt: skip
    yield Case("a wall seen askew", "incidence in the middle / degrees", tuple(
        (angle, _scene(_wall(8.0, 90.0 - angle)), quiet) for angle in _INCIDENCE_DEG
    ))  # fmt: skip
    box = SceneObject(name="box", body="box", path=Path(start_m=(5.0, 0.8, 0.0)))
    yield Case("a box on the floor and a person", "distance of the person / m", tuple(
        (away, _scene(box, _person("one", away, -0.8)), quiet) for away in (4.0, 5.0, 6.0)
    ))  # fmt: skip
    moving = [
        SceneObject(name=name, body="person", follow_path=True,
                    path=Path(start_m=(x, -1.2 * side, 0.0), velocity_mps=(0.0, 1.5 * side, 0.0)))
        for name, x, side in (("one", 5.0, 1.0), ("other", 5.7, -1.0))
    ]  # fmt: skip
    yield Case("people who cross", "time / s", tuple(
        (seconds, _scene(*moving, duration_s=seconds), quiet) for seconds in (0.6, 0.8, 1.0, 1.4)
    ))  # fmt: skip
    yield Case("noise", "read noise / LSB", tuple(
        (noise, _scene(_person("one", 6.0, 0.5), _person("other", 7.5, -0.5), _wall(9.0, 90.0)), noise)
        for noise in _READ_NOISE_LSB
    ))  # fmt: skip


def _person(name: str, x_m: float, y_m: float) -> SceneObject:
    return SceneObject(name=name, body="person", heading_deg=180.0, path=Path(start_m=(x_m, y_m, 0.0)))


def _wall(x_m: float, heading_deg: float) -> SceneObject:
    box = Box(center_m=(0.0, 0.0, 1.0), size_m=(4.0, 0.2, 2.0), reflectivity=0.5)
    return SceneObject(name="wall", boxes=(box,), heading_deg=heading_deg, path=Path(start_m=(x_m, 0.0, 0.0)))


def _scene(*things: SceneObject, duration_s: float = 0.1) -> Scenario:
    named = {"name": "segments", "description": "", "preset": "road_cw", "ground_reflectivity": 0.2}
    return Scenario(**named, duration_s=duration_s, frame_rate_hz=10.0, objects=things)  # type: ignore[arg-type]  # all are text


def _score(scene: Scenario, noise: float, method: str, seed: int) -> Score:
    """Return the score of the last frame of a scene: of what was tracked until then, for the method that asks."""
    config = _config(noise, method)
    tracks, scored = Tracks.empty(), None
    for capture in frames(scene, config, seed):
        frame = process_frame(capture.raw, tracks, capture.ego, config)
        tracks = frame.tracks
        assert capture.truth is not None  # a simulated camera knows it
        scored = rates(frame.labels, np.where(frame.image.valid, capture.truth.object_id, 0))
    assert scored is not None  # a scene has a frame
    return scored


def _config(noise: float, method: str) -> Config:
    camera = {"read_noise_lsb": noise, "freeze_motion": True}
    return load_config("road_cw", {"segmentation": method, "camera": camera})


def rates(labels: Ints, objects: Ints) -> Score:
    """Return the score of labels (H, W) of a segmentation for the numbers of true objects (H, W), 0 for none.

    An object is in several segments if each of them holds a tenth of its pixels, and shares one if its largest holds a
    tenth of another's. Its overlap is that with the segment that fits best. Objects below eight pixels do not count.
    """
    numbers, counts = np.unique(objects[objects > 0], return_counts=True)
    numbers, counts = numbers[counts >= _LEAST_PIXELS], counts[counts >= _LEAST_PIXELS]
    table: Floats = np.zeros((len(numbers), int(labels.max(initial=0)) + 1))
    for row, number in enumerate(numbers):
        table[row] = np.bincount(labels[objects == number], minlength=table.shape[1])
    inside, sizes = table[:, 1:], np.bincount(labels.ravel(), minlength=table.shape[1])[1:]
    if not inside.size:
        return Score(0.0, 0.0, 0.0)
    large = inside >= _PART * counts[:, None]
    over = large.sum(axis=1) > 1
    best = inside.argmax(axis=1)
    under = np.array([large[:, best[k]].sum() > 1 and large[k, best[k]] for k in range(len(numbers))])
    overlap = (inside / np.maximum(counts[:, None] + sizes - inside, 1)).max(axis=1)
    return Score(float(over.mean()), float(under.mean()), float(overlap.mean()))
