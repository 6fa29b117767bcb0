"""Rain and snow before a camera: each drop or flake is one more source of light in its pixel (König 2008, 5.2.1.3).

It works on the `View`, so that every family of cameras sees it. What is far away or small only dims what is behind.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from rangecam.errors import UsageError
from rangecam.geometry import Lens, Mounting, is_plain, pixel_of, pixel_pitch, pixel_steps, position, rays, rotation
from rangecam.scene.paths import Pose, Vector
from rangecam.scene.view import View
from rangecam.settings import Fraction, NonNegative, Positive, PositiveInt, settings
from rangecam.types import Floats

_MARGIN_M = 0.2
_POINTS = 1024
_STREAK_STEPS = 8
_WIDEST_RAD = math.radians(87.5)
_WATER_KGPM3 = 1000.0


@settings
class Drop:
    """One drop, bead or flake that hangs in the air before the vehicle."""

    position_m: Vector
    """Its centre in vehicle axes."""
    diameter_m: Positive
    """Its diameter; 6 mm in fig 5.5, 4 mm the glass bead of fig 5.8."""
    kind: Literal["water", "snow"] = "water"
    """water: a sphere that mirrors, also one of glass; snow: a diffuse one."""


@settings
class Cloud:
    """A cloud of dust or spray: diffuse grains, normally distributed around its middle, that drift with the wind.

    Grains are larger and fewer than real ones; what counts is how much of its footprint a pixel sees covered.
    """

    position_m: Vector
    """Its middle at time 0, on the ground's axes."""
    velocity_mps: Vector = (0.0, 0.0, 0.0)
    """Of its middle, over ground."""
    radius_m: Positive = 0.5
    """Standard deviation of the grains from its middle, along each axis."""
    grains: PositiveInt = 5000
    """How many."""
    diameter_m: Positive = 1e-3
    """Of a grain; as bright as snow (`snow_reflectivity`)."""


@settings
class Weather:
    """What falls between camera and scene; by default nothing."""

    rain_mm_per_h: NonNegative = 0.0
    """Rain rate; the sizes of drops follow Marshall and Palmer (1948), their speed Atlas et al. (1973)."""
    snow_mm_per_h: NonNegative = 0.0
    """Snowfall as rate of the melted water; the melted sizes follow Gunn and Marshall (1958)."""
    drops: tuple[Drop, ...] = ()
    """Drops at given places, which do not fall."""
    clouds: tuple[Cloud, ...] = ()
    """Clouds of dust or spray."""
    smallest_radius_m: Positive = 1e-4
    """Drops of the random field are no smaller; 1e2 um in 5.2.1.3."""
    largest_radius_m: Positive = 4e-3
    """And no larger: 5.2.1.3 has 1e4 um, real drops break up above 4 mm (E-K-43); for snow that of the melted flake."""
    nearest_m: Positive = 0.1
    """Nothing of the random field is nearer to the camera: its housing. *open*"""
    within_m: Positive = 5.0
    """So far drops are seen one by one; beyond, they only dim. *open*"""
    refractive_index: Annotated[float, Interval(gt=1, lt=2)] = 1.3265
    """Of the drops; water at 905 nm mirrors 1.97 % of the light (N-K-070), glass of 1.5 mirrors 4 %."""
    rear_reflection: bool = True
    """Light that enters a drop, is mirrored by its rear and focused back; N-K-070 to N-K-072 leave it out."""
    snow_reflectivity: Fraction = 0.8
    """Lambertian reflectivity of flakes. *open*"""
    snow_density_kgpm3: Positive = 100.0
    """Mass of flakes over their volume: how much larger they are than the drops to which they melt. *open*"""
    snow_fall_mps: NonNegative = 1.0
    """Speed of falling flakes. *open*"""
    streak_s: NonNegative = 0.0
    """Time of one exposure, over which the fall smears each drop in the image; 0: as if it stood still. *open*"""


@dataclass(frozen=True, eq=False)
class Particles:
    """What is in the air at one moment: position_m, velocity_mps (N, 3) in vehicle axes, diameter_m, mirrors (N,)."""

    position_m: Floats
    velocity_mps: Floats
    diameter_m: Floats
    mirrors: NDArray[np.bool_]


class _Sizes(NamedTuple):
    """An exponential distribution of melted diameters, cut off: N(D) = per_m4 exp(-steepness D), from least to most."""

    per_m4: float
    steepness_perm: float
    least_m: float
    most_m: float
    swelling: float
    """Diameter in the air over the melted one."""


def precipitation(
    weather: Weather, lens: Lens, mounting: Mounting, shape: tuple[int, int], rng: np.random.Generator, speed_mps: float
) -> Particles:
    """Return a random field of drops and flakes before the camera, and the given ones.

    It fills a cone that holds the view of the camera, with a margin of 0.2 m for what falls into it meanwhile.
    speed_mps: of the own vehicle, forward: what falls comes nearer so fast. Raises UsageError if the smallest drops are
    not smaller than the largest.
    """
    parts = [_given(weather)]
    for sizes, mirrors in ((_rain(weather), True), (_snow(weather), False)):
        if sizes is None:
            continue
        position_m = _positions(_density_perm3(sizes), weather, lens, shape, rng)
        diameter_m = sizes.swelling * _melted_m(sizes, rng.random(len(position_m)))
        fall_mps = rain_fall_mps(diameter_m) if mirrors else np.full(diameter_m.shape, weather.snow_fall_mps)
        velocity_mps = np.stack([np.full_like(fall_mps, -speed_mps), np.zeros_like(fall_mps), -fall_mps], axis=-1)
        in_vehicle_m = position_m @ rotation(mounting).T + position(mounting)
        parts.append(Particles(in_vehicle_m, velocity_mps, diameter_m, np.full(diameter_m.shape, mirrors)))
    return joined(*parts)


def clouds(weather: Weather, time_s: float, own: Pose, rng: np.random.Generator) -> Particles:
    """Return the grains of the clouds at `time_s`, in axes of the vehicle at `own`; each time others of the cloud."""
    empty = Particles(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool))
    return joined(empty, *(_grains(cloud, time_s, own, rng) for cloud in weather.clouds))


def _grains(cloud: Cloud, time_s: float, own: Pose, rng: np.random.Generator) -> Particles:
    c, s = math.cos(own.heading_rad), math.sin(own.heading_rad)
    into = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    wind = np.array(cloud.velocity_mps)
    middle = into @ (np.array(cloud.position_m) + wind * time_s - (own.x_m, own.y_m, 0.0))
    placed = middle + cloud.radius_m * rng.standard_normal((cloud.grains, 3))
    placed = placed[placed[:, 2] > 0]  # not in the ground
    moving = into @ wind - (own.speed_mps, 0.0, 0.0) - np.cross([0.0, 0.0, own.yaw_rate_radps], placed)
    return Particles(placed, moving, np.full(len(placed), cloud.diameter_m), np.zeros(len(placed), bool))


def joined(*several: Particles) -> Particles:
    """Return all particles of several fields as one."""
    columns = zip(*((p.position_m, p.velocity_mps, p.diameter_m, p.mirrors) for p in several), strict=True)
    return Particles(*(np.concatenate(column) for column in columns))


def in_weather(
    view: View, falling: Particles, weather: Weather, lens: Lens, mounting: Mounting, after_s: float
) -> View:
    """Return what the camera sees of `view` through the weather, `after_s` after the moment of `falling`.

    The light of each drop comes to that of its pixel as one more ray with its range and an effective reflectivity:
    - a water drop mirrors the camera's own light in a point: R0/4 times the part of the pixel's footprint that it would
      cover, with 1 + (1 - R0)^2 (n / (2 - n))^2 for its rear. Its light falls with the fourth power of the range
      (E-K-14), however near: a point fills no pixel. Only blur, which is the camera's, ends that.
    - a flake is a Lambertian ball: its reflectivity times the part of the footprint that it covers, with 2/3 of the
      light of a plate. That is the fourth power while it is smaller than the footprint, and the square where larger.
    Everything is dimmed by exp(-2 extinction range). No drop hides what is behind it but by that: near drops are much
    smaller than the aperture of the lens, far ones than the footprint.
    """
    shape = (view.range_m.shape[1], view.range_m.shape[2])
    dim = _dimmed(view, extinction_perm(weather))
    flat, range_m, reflectivity, cos_incidence = _sources(falling, weather, lens, mounting, shape, after_s)
    if not len(flat):
        return dim
    order = np.argsort(flat, kind="stable")
    sorted_flat = flat[order]
    layer = np.arange(len(order)) - np.searchsorted(sorted_flat, sorted_flat)
    rays_before, layers = len(view.range_m), int(layer.max()) + 1
    count = rays_before + layers
    seen = np.exp(-2 * extinction_perm(weather) * range_m)
    place = (rays_before + layer) * (shape[0] * shape[1]) + sorted_flat

    def added(rays: Floats, values: Floats, empty: float) -> Floats:
        both = np.full((count, *shape), empty, np.result_type(rays, np.float32))
        both[:rays_before] = rays
        both.reshape(-1)[place] = values[order].astype(np.float32)
        return both

    return replace(
        view,
        range_m=added(view.range_m, range_m, np.inf),
        # the camera takes the mean over all rays of a pixel
        reflectivity=added(dim.reflectivity * np.float32(count / rays_before), count * reflectivity * seen, 0.0),
        cos_incidence=added(view.cos_incidence, cos_incidence, 0.0),
    )


def mirrored(weather: Weather) -> float:
    """Return the reflectivity of a Lambertian disc across the ray that sends as much light back as a mirroring drop.

    A quarter of the Fresnel reflection R0 of its front, and, if `rear_reflection`, that of its rear, which sends
    paraxial rays back (n / (2 - n))^2 times as bright, after two passages of the surface.
    """
    n = weather.refractive_index
    front = ((n - 1) / (n + 1)) ** 2
    rear = (1 - front) ** 2 * (n / (2 - n)) ** 2 if weather.rear_reflection else 0.0
    return front / 4 * (1 + rear)


def extinction_perm(weather: Weather) -> float:
    """Return the part of the light that rain and snow take out of a narrow beam on each metre, 1/m.

    The cross-sections of all drops; what they diffract goes on within the pixel (geometric optics, not twice that).
    """
    total = 0.0
    for sizes in (_rain(weather), _snow(weather)):
        if sizes is not None:
            total += math.pi / 4 * sizes.swelling**2 * _second_moment(sizes)
    return total


def rain_fall_mps(diameter_m: Floats) -> Floats:
    """Return the terminal speed of drops, m/s (Atlas, Srivastava and Sekhon 1973); those below 0.2 mm all as fast."""
    speed: Floats = 9.65 - 10.3 * np.exp(-600 * np.maximum(diameter_m, 2e-4))
    return speed


def pixel_solid_angles(lens: Lens, shape: tuple[int, int]) -> Floats:
    """Return the solid angle that each pixel sees, sr (H, W)."""
    if not is_plain(lens):
        steps = pixel_steps(lens, shape)
        bent: Floats = np.linalg.norm(np.cross(steps[:, :, 0], steps[:, :, 1]), axis=-1)
        return bent
    across, down = pixel_pitch(lens, shape)
    directions = rays(lens, shape)
    x, level = directions[..., 0], np.hypot(directions[..., 0], directions[..., 1])
    area: Floats = across * down * (x**3 if lens.projection == "perspective" else level)
    return area


def _given(weather: Weather) -> Particles:
    count = len(weather.drops)
    return Particles(
        np.array([drop.position_m for drop in weather.drops]).reshape(count, 3),
        np.zeros((count, 3)),
        np.array([drop.diameter_m for drop in weather.drops]).reshape(count),
        np.array([drop.kind == "water" for drop in weather.drops], bool),
    )


def _rain(weather: Weather) -> _Sizes | None:
    """Marshall and Palmer 1948: 8000 drops a m3 and mm, 4.1 R^-0.21 a mm."""
    rate = weather.rain_mm_per_h
    return _Sizes(8e6, 4100 * rate**-0.21, *_ends_m(weather), 1.0) if rate else None


def _snow(weather: Weather) -> _Sizes | None:
    """Gunn and Marshall 1958, melted: 3800 R^-0.87 a m3 and mm, 2.55 R^-0.48 a mm."""
    rate = weather.snow_mm_per_h
    swelling = (_WATER_KGPM3 / weather.snow_density_kgpm3) ** (1 / 3)
    return _Sizes(3.8e6 * rate**-0.87, 2550 * rate**-0.48, *_ends_m(weather), swelling) if rate else None


def _ends_m(weather: Weather) -> tuple[float, float]:
    """Return the least and the most melted diameter; raises UsageError if there is nothing between them."""
    if weather.smallest_radius_m >= weather.largest_radius_m:
        raise UsageError(
            f"weather.smallest_radius_m = {weather.smallest_radius_m:g}: "
            f"must be below weather.largest_radius_m = {weather.largest_radius_m:g}"
        )
    return 2 * weather.smallest_radius_m, 2 * weather.largest_radius_m


def _density_perm3(sizes: _Sizes) -> float:
    """Return how many there are in a cubic metre."""
    least, most = (math.exp(-sizes.steepness_perm * end) for end in (sizes.least_m, sizes.most_m))
    return sizes.per_m4 / sizes.steepness_perm * (least - most)


def _melted_m(sizes: _Sizes, uniform: Floats) -> Floats:
    """Return diameters by the inverse of their cumulative distribution."""
    least, most = (math.exp(-sizes.steepness_perm * end) for end in (sizes.least_m, sizes.most_m))
    diameter_m: Floats = -np.log(least - uniform * (least - most)) / sizes.steepness_perm
    return diameter_m


def _second_moment(sizes: _Sizes) -> float:
    """Return the integral of D^2 N(D), 1/m."""
    k = sizes.steepness_perm

    def rest(d: float) -> float:
        return math.exp(-k * d) * (d * d / k + 2 * d / k**2 + 2 / k**3)

    return sizes.per_m4 * (rest(sizes.least_m) - rest(sizes.most_m))


def _positions(
    density_perm3: float, weather: Weather, lens: Lens, shape: tuple[int, int], rng: np.random.Generator
) -> Floats:
    """Return random places in camera axes (N, 3): in a cone around the view whose apex lies behind the camera."""
    corners = rays(lens, shape)[[0, 0, -1, -1], [0, -1, 0, -1], 0]
    half_rad = min(math.acos(corners.min()) + max(pixel_pitch(lens, shape)), _WIDEST_RAD)
    behind_m = _MARGIN_M / math.sin(half_rad)
    length_m = weather.within_m + behind_m
    volume_m3 = 2 * math.pi / 3 * (1 - math.cos(half_rad)) * length_m**3
    count = rng.poisson(density_perm3 * volume_m3)
    distance_m = length_m * np.cbrt(rng.random(count))
    cosine = 1 - rng.random(count) * (1 - math.cos(half_rad))
    around, sine = 2 * math.pi * rng.random(count), np.sqrt(1 - cosine**2)
    directions = np.stack([cosine, sine * np.cos(around), sine * np.sin(around)], axis=-1)
    places_m: Floats = distance_m[:, None] * directions - np.array([behind_m, 0.0, 0.0])
    from_camera_m = np.linalg.norm(places_m, axis=1)
    inside: Floats = places_m[(from_camera_m >= weather.nearest_m) & (from_camera_m <= weather.within_m)]
    return inside


def _dimmed(view: View, extinction: float) -> View:
    if extinction == 0:
        return view
    passed = np.exp(-2 * extinction * np.where(np.isfinite(view.range_m), view.range_m, 0.0))
    return replace(view, reflectivity=(view.reflectivity * passed).astype(np.float32))


def _sources(
    falling: Particles, weather: Weather, lens: Lens, mounting: Mounting, shape: tuple[int, int], after_s: float
) -> tuple[NDArray[np.intp], Floats, Floats, Floats]:
    """Return pixel (flat index), range, reflectivity of the whole pixel and cosine of each source of light, (M,)."""
    steps = (np.arange(_STREAK_STEPS) + 0.5) / _STREAK_STEPS - 0.5 if weather.streak_s else np.zeros(1)
    solid_sr = pixel_solid_angles(lens, shape).ravel()
    found = []
    for step in steps:
        moved_m = falling.position_m + (after_s + step * weather.streak_s) * falling.velocity_mps
        seen_m = (moved_m - position(mounting)) @ rotation(mounting)
        ahead = np.flatnonzero(seen_m[:, 0] > 0)
        seen_m = seen_m[ahead]
        pixel, which, share = _covered(seen_m, falling.diameter_m[ahead], falling.mirrors[ahead], lens, shape)
        who, range_m = ahead[which], np.linalg.norm(seen_m[which], axis=1)
        mirrors = falling.mirrors[who]
        part = share * math.pi / 4 * falling.diameter_m[who] ** 2 / (range_m**2 * solid_sr[pixel])
        bright = np.where(mirrors, part * mirrored(weather), np.minimum(part, 1.0) * weather.snow_reflectivity)
        found.append((pixel, range_m, bright / len(steps), np.where(mirrors, 1.0, 2 / 3)))
    flat, range_m, reflectivity, cosine = (np.concatenate(column) for column in zip(*found, strict=True))
    return flat, range_m, reflectivity, cosine


def _covered(
    seen_m: Floats, diameter_m: Floats, mirrors: NDArray[np.bool_], lens: Lens, shape: tuple[int, int]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Return the pixels that particles light, the particle (index) of each, and what share of it: (M,) each.

    seen_m (N, 3): in camera axes, before the camera. A mirroring drop is a point; a flake as large as a third of a
    pixel or more is taken as points spread evenly over its disc.
    """
    if mirrors.all():
        pixel, inside = _pixels(seen_m, lens, shape)
        which = np.flatnonzero(inside)
        return pixel[which], which, np.ones(len(which))
    range_m = np.linalg.norm(seen_m, axis=1)
    spread = ~mirrors & (diameter_m > min(pixel_pitch(lens, shape)) * range_m / 3)
    k = np.arange(_POINTS)
    radius, around = np.sqrt((k + 0.5) / _POINTS) / 2, k * math.pi * (3 - math.sqrt(5))
    disc = np.stack([np.zeros(_POINTS), radius * np.cos(around), radius * np.sin(around)], axis=-1)
    points_m = (seen_m[spread, None] + diameter_m[spread, None, None] * disc).reshape(-1, 3)
    who = np.concatenate([np.flatnonzero(~spread), np.repeat(np.flatnonzero(spread), _POINTS)])
    weight = np.concatenate([np.ones(len(seen_m) - int(spread.sum())), np.full(len(points_m), 1 / _POINTS)])
    pixel, inside = _pixels(np.concatenate([seen_m[~spread], points_m]), lens, shape)
    pairs, place = np.unique(who[inside] * (shape[0] * shape[1]) + pixel[inside], return_inverse=True)
    share = np.bincount(place, weight[inside], len(pairs)).astype(np.float64)
    return pairs % (shape[0] * shape[1]), pairs // (shape[0] * shape[1]), share


def _pixels(points_m: Floats, lens: Lens, shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the flat index of the pixel that sees each point in camera axes, and whether there is one: (N,)."""
    height, width = shape
    row, column = (np.floor(place + 0.5) for place in pixel_of(points_m, lens, shape))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return np.where(inside, row * width + column, 0).astype(np.intp), inside
