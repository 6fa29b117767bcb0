"""Merges and splits: the compiled kernels do what the plain version does, and the quick look beforehand misses none."""

import numpy as np
import pytest

import plain_groups as plain
from rangecam.tracking.grouping import concerned
from rangecam.tracking.groups import regroup
from rangecam.tracking.settings import TrackingSettings
from rangecam.tracking.shape import first_memory, shapes
from rangecam.types import MEMORY, Tracks

SETTINGS, GATE = TrackingSettings(max_parts_frames=4), 16.27
Scene = tuple[Tracks, np.ndarray, np.ndarray, tuple[np.ndarray, ...], np.ndarray]


def spread(rng: np.random.Generator, n: int, sigma: float) -> np.ndarray:
    root = sigma * rng.standard_normal((n, 9, 9))
    return root @ root.transpose(0, 2, 1) / 9


def scene(rng: np.random.Generator, n: int, m: int, room_m: float) -> Scene:
    """Tracks and segments at random in a room, so small that many are near each other; who took which, at random."""
    width = rng.uniform(0.3, 0.7, n)
    memory = first_memory(np.concatenate([rng.normal(0, 0.3, (n, 3)), np.full((n, 4), 0.02)], axis=1), 0.3)
    memory[:, 0], memory[:, 1] = np.log(width), np.log(rng.uniform(1.5, 1.9, n))
    memory[:, MEMORY.index("merged")] = rng.choice([0, 0, 2], n)
    memory[:, MEMORY.index("parts")] = rng.integers(0, 6, n)
    x = np.zeros((n, 9))
    x[:, ::3] = np.array([7, 0, 0.9]) + room_m * rng.uniform(-0.5, 0.5, (n, 3)) * [0.4, 1.0, 0.2]
    height, columns = rng.uniform(1.4, 2.0, m), rng.integers(1, 9, m)
    size = np.stack([np.full(m, 0.2), rng.choice([0.2, 0.5, 1.0, 1.3], m), height], axis=1)
    seen = (
        *(np.arange(1, m + 1), np.array([7, 0, 0.9]) + room_m * rng.uniform(-0.5, 0.5, (m, 3)) * [0.4, 1.0, 0.2]),
        *(spread(rng, m, 0.05)[:, :3, :3], size, rng.uniform(6, 8, m), rng.integers(1, 300, m)),
        *(np.stack([0 * columns, columns, 20 + columns, 9 + columns], axis=1), rng.uniform(6, 8, m)),
        *(rng.uniform(5, 50, m), rng.uniform(0.01, 0.1, m), rng.choice([0, 0, 1, 2, 16], m).astype(np.uint8)),
    )
    seen = (*seen, seen[1][:, 1:2] + seen[3][:, 1:2] * [0.5, -0.5])
    if m and rng.random() < 0.1:
        seen[1][rng.integers(m), 0] = np.nan
    took, free = np.full(n, -1), rng.permutation(np.flatnonzero(np.isfinite(seen[1]).all(axis=1)))
    who = rng.permutation(n)[: min(n, len(free), int(rng.integers(0, n + 1)))]
    took[who] = free[: len(who)]
    status = rng.choice([0, 1, 2], n, p=[0.2, 0.5, 0.3])
    tracks = Tracks.empty()
    fields = {"status": status, "track_id": rng.permutation(50)[:n] + 1, "n_pixels": rng.uniform(20, 300, n)}
    fields |= {"size_m": np.stack([np.full(n, 0.2), width, np.full(n, 1.7)], axis=1), "state": x}
    return Tracks(**{**vars(tracks), **fields, "covariance": spread(rng, n, 0.3)}), memory, x, seen, took


def both(case: Scene, most_parts: int = 4) -> tuple[object, object]:
    """What the kernels and what the plain version make of a scene."""
    tracks, memory, x, seen, took = case
    R, shape = seen[2] + 0.01 * np.eye(3), shapes(seen)  # type: ignore[arg-type]
    missed = -2 * np.log(1 - SETTINGS.detection_probability)
    P = tracks.covariance
    slow = plain.Scene(
        *(tracks.status, tracks.track_id, tracks.n_pixels, tracks.size_m, memory),
        *(x[:, ::3], P[:, ::3, ::3], seen, R, shape, GATE, missed),  # type: ignore[arg-type]
    )
    quick = regroup(tracks, memory, (x, P), (seen, R, shape), took, GATE, SETTINGS)  # type: ignore[arg-type]
    return quick, plain.regroup(slow, took, most_parts)


def test_the_kernels_find_and_make_the_same_merges_and_parts_as_the_plain_version() -> None:
    rng, merges, parts = np.random.default_rng(3), 0, 0
    for _ in range(600):
        case = scene(rng, int(rng.integers(0, 8)), int(rng.integers(0, 6)), float(rng.choice([1.0, 2.0, 5.0])))
        quick, slow = both(case)
        assert (quick is None) == (slow is None)
        if quick is None or slow is None:
            continue
        np.testing.assert_array_equal(quick.used, slow.used)  # type: ignore[attr-defined]
        np.testing.assert_array_equal(quick.group, slow.group)  # type: ignore[attr-defined]
        np.testing.assert_array_equal(quick.parts, slow.parts)  # type: ignore[attr-defined]
        for i, (k, j) in enumerate(zip(quick.took, slow.took, strict=True)):  # type: ignore[attr-defined]
            assert (k >= 0) == (j >= 0), i
            for one, other in zip(quick.seen, slow.seen, strict=True) if k >= 0 else ():  # type: ignore[attr-defined]
                np.testing.assert_allclose(one[k], other[j], rtol=1e-9, atol=1e-9)
        merges += int((quick.group > 0).any())  # type: ignore[attr-defined]
        parts += int((quick.parts < 5).any() and (quick.parts > case[1][:, MEMORY.index("parts")]).any())  # type: ignore[attr-defined]
    assert merges > 30
    assert parts > 30


def test_more_than_five_in_one_segment_are_tried_each_alone_and_all_together() -> None:
    rng, found = np.random.default_rng(4), 0
    for _ in range(40):
        case = scene(rng, 8, 1, 1.0)
        case[0].status[:], case[4][:] = 1, -1
        case[0].covariance[:] *= 0.01
        case[2][:, 3] = case[3][1][0, 1] + np.linspace(-1.6, 1.6, 8)
        case[3][3][0, 1], case[1][:, 0] = 3.6, np.log(0.4)
        case[3][1][0, 2] = case[2][:, 6].mean()
        quick, slow = both(case)
        assert (quick is None) == (slow is None)
        if quick is not None:
            np.testing.assert_array_equal(quick.group, slow.group)  # type: ignore[attr-defined]
            found += int((quick.group > 0).sum() == 8)  # type: ignore[attr-defined]
    assert found > 0


@pytest.mark.parametrize("room_m", [1.0, 3.0, 9.0])
def test_where_the_quick_look_sees_nothing_nothing_is_merged_or_in_parts(room_m: float) -> None:
    rng, nothing = np.random.default_rng(5), 0
    for _ in range(200):
        case = scene(rng, int(rng.integers(0, 6)), int(rng.integers(0, 6)), room_m)
        tracks, memory, x, seen, took = case
        tracks.status[took >= 0] = np.maximum(tracks.status[took >= 0], 1)
        look = concerned(tracks.status, tracks.size_m, memory, x, tracks.covariance, seen[1], seen[3], took, 4.0)
        if not look:
            nothing += 1
            assert both(case) == (None, None)
    assert nothing > (0 if room_m == 1.0 else 20)
