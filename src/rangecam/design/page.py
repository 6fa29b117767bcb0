"""What is said of designs: lines for people, and one HTML page that opens offline."""

import math
from collections.abc import Sequence
from typing import Any

from rangecam.design import figures
from rangecam.design.analysis import Design
from rangecam.design.experiment import TRIED_FROM_M
from rangecam.design.limits import Limits
from rangecam.report.template import page, section


def describe(designs: Sequence[Design]) -> str:
    """Return the numbers and limits of designs as lines."""
    return "\n\n".join("\n".join([*_numbers(design), "", *_limits(design)]) for design in designs)


def html(designs: Sequence[Design]) -> bytes:
    """Return the page: numbers and limits, accuracy, spread and bias, light, all points."""
    plan = designs[0].plan
    sure = f"{100 * plan.confidence:g} %"
    parts = [
        section(
            "Accuracy over range",
            f"Root mean square error of valid ranges, with intervals of {sure} from simulated images; lines: what the "
            "chain expects of its noise; dashed: the target. Faint: fewer pixels are valid than asked for.",
            figures.accuracy(designs),
            "\n\n".join("\n".join(_limits(design)) for design in designs),
        ),
        section(
            "Spread and bias",
            "Standard deviation and mean of the error of valid ranges. Of targets of which few pixels are valid, those "
            "remain whose noise made them so, and that shows as bias.",
            figures.spread_and_bias(designs),
        ),
        section(
            "Light",
            "How many pixels are valid, and how much light there is.",
            figures.light(designs),
            "\n\n".join("\n".join(_points(design)) for design in designs),
        ),
    ]
    title = "Design: " + ", ".join(design.name for design in designs)
    lead = (
        f"Targets that each pixel sees squarely, {plan.frames} images each of {plan.side} x {plan.side} pixels on the "
        "optical axis, and of the four corner pixels of the image, simulated and ranged as recordings are."
    )
    return page(title, lead, "\n\n".join("\n".join(_numbers(design)) for design in designs), parts).encode("utf-8")


def _numbers(design: Design) -> list[str]:
    n = design.numbers
    near, far = n["measurement_range_m"]
    fastest = n["fastest_frame_rate_hz"]
    lines = [
        f"{design.name}: {n['camera']}, {n['columns']} x {n['rows']} pixels, "
        f"{n['field_of_view_deg'][0]:.4g} x {n['field_of_view_deg'][1]:.4g} degrees",
        f"measurement range  {_span(near, far)} ({n['ranging']})",
        f"frame rate         {n['frame_rate_hz']:.4g} Hz" + (f", at most {fastest:.4g} Hz" if fastest else ""),
        f"raw data           {n['bytes_per_frame']} bytes a frame, {n['mbit_per_s']:.4g} Mbit/s "
        f"({', '.join(n['raw_planes'])})",
        "pixel footprint    "
        + ", ".join(
            f"{100 * f['width_m']:.3g} x {100 * f['height_m']:.3g} cm at {f['range_m']:.3g} m"
            for f in n["pixel_footprints"]
        ),
        *(_unwrapping(n["unwrapping"]) if "unwrapping" in n else []),
        *(_light(n["light"]) if "light" in n else []),
        *(_eye(n["eye_safety"]) if "eye_safety" in n else []),
        *(f"warning            {text}" for text in design.warnings),
    ]
    return lines


def _unwrapping(n: dict[str, Any]) -> list[str]:
    together = " + ".join(f"{hertz / 1e6:g}" for hertz in n["modulations_hz"])
    lines = [f"unwrapping         {together} MHz, unambiguous to {n['unambiguous_m']:.4g} m"]
    for row in n["at"]:
        rates = f"{row['gross']:.2g} of the pixels with wrong wraps"
        if "rejected" in row:
            rates += f"; {row['accepted_gross']:.2g} accepted, {row['rejected']:.2g} rejected"
        lines.append(f"{'':19}{row['phase_sigma_rad']:g} rad of noise: {1000 * row['sigma_m']:.3g} mm, {rates}")
    return lines


def _light(n: dict[str, Any]) -> list[str]:
    needed, span = n["needed_input_range_db"], n["needed_for"]
    lines = [
        f"full scale         {n['full_scale_jpm2'] * 1e6:.4g} uJ/m2, {n['full_scale_electrons']:.3g} electrons a pulse",
        f"noise equivalent   {n['nee_sensor_jpm2'] * 1e9:.4g} nJ/m2 of the sensor, "
        f"{n['nee_system_jpm2'] * 1e9:.4g} with read-out",
        f"dynamic range      {n['dynamic_range_db']:.4g} dB",
    ]
    if needed is not None:
        lines[-1] += (
            f"; {needed:.4g} dB are needed from {span['range_m'][0]:.3g} to {span['range_m'][1]:.3g} m, "
            f"{100 * span['reflectivity'][0]:g} to {100 * span['reflectivity'][1]:g} %"
        )
    return lines


def _eye(n: dict[str, Any]) -> list[str]:
    lines = [f"light source       {n['pulse_energy_j'] * 1e6:.4g} uJ a pulse, {n['mean_power_w']:.4g} W on average"]
    if n["unknown"]:
        return [*lines, f"eye safety         not known: {n['unknown']}"]
    at = ", ".join(f"{row['margin']:.3g} at {row['range_m']:g} m" for row in n["at"])
    lines.append(f"eye safety         margin to class 1: {at} (below 1: exceeded); assumed: {n['assumed']}")
    if n["class_1_from_m"] is not None:
        lines[-1] += f"; class 1 from {n['class_1_from_m']:.3g} m on"
    return lines


def _limits(design: Design) -> list[str]:
    plan = design.plan
    lines = [
        f"{design.name}: error up to {100 * plan.accuracy:g} % of the range with {100 * plan.valid:g} % of the pixels "
        "valid:"
    ]
    for one in design.limits:
        lines += _limit(one)
    for rho, at_m in design.saturated_m.items():
        if at_m > 0:
            lines.append(f"saturated          {100 * rho:3g} %: nearer than {_m(at_m)}")
    return lines


def _limit(one: Limits) -> list[str]:
    head = f"{one.region:8} {100 * one.reflectivity:9g} %: "
    if math.isnan(one.nearest_m):
        return [head + one.far]
    gaps = "" if one.complete else ", but not throughout"
    return [
        f"{head}{_m(one.nearest_m)} to {_m(one.farthest_m)}{gaps}",
        f"{'near end':>18}: {one.near}",
        f"{'far end':>18}: {one.far}",
    ]


def _points(design: Design) -> list[str]:
    lines = [
        f"{design.name:20} {'range m':>8} {'valid %':>8} {'bias cm':>9} {'spread cm':>10} {'says cm':>8} "
        f"{'error %':>8} {'accumul.':>8} refused as"
    ]
    for p in design.points:
        count = "" if p.n_acc is None else f"{p.n_acc:.3g}"
        lines.append(
            f"{p.region:8} {100 * p.reflectivity:9g} % {p.range_m:8.3f} {100 * p.valid.value:8.1f} "
            f"{100 * p.bias.value:9.3f} {100 * p.spread.value:10.3f} {100 * p.sigma_m:8.3f} "
            f"{100 * p.error.value / p.range_m:8.3f} {count:>8} {p.refused}"
        )
    return lines


def _span(near: float | None, far: float | None) -> str:
    if near is None or far is None:
        return "none: no target of whatever brightness is ranged right"
    return f"{'up' if near <= TRIED_FROM_M else _m(near)} to {_m(far)}"


def _m(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3g} m"
