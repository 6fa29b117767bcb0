"""The sensor on the bench: responsivity, shutter function, accumulation, noise in the light, correlation."""

from dataclasses import replace

import numpy as np
from scipy.optimize import curve_fit

from rangecam.optics import irradiance_on_sensor
from rangecam.pulsed.bit_pattern import SIGNALS, Sequencer, execute, table_of
from rangecam.pulsed.camera import simulate
from rangecam.pulsed.limits import targets_on_axis
from rangecam.pulsed.settings import Laser, PulsedCamera
from rangecam.pulsed.signal import correlation_curve, pulse_shape, shutter_windows
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged
from rangecam.studies.virtual import looking_at, measured_edges, quiet
from rangecam.types import Floats

RESPONSIVITY, DAMPING = 2617.0, 0.0153
DIRAC_S = 100e-12
SHUTTERS_S = (90e-9, 180e-9, 390e-9)
AT_M, REFLECTIVITY = 1.0, 0.5
_ROWS, _COLUMNS = 400, 200
_PULSES = (1, 2, 4, 8, 16, 32, 64, 100)
_STEP_S = 5e-9
_CLOCK_S = Sequencer().clock_step_s


def pulsed_sensor(rng: np.random.Generator) -> Study:
    """The sensor on the bench: responsivity, shutter function, accumulation, noise in the light, correlation.

    rng: of the simulated images.
    """
    exposure, lit_v, error_v = _responsivity(rng)
    windows = {width_s: _sampled_shutter(width_s, rng) for width_s in SHUTTERS_S}
    grown_v = np.array([_values(_counting(n, 1.2), "shutter_a", rng).mean() for n in _PULSES])
    bright = _bright_noise(rng)
    delays_s, found, calculated = _correlation(rng)
    claims = [
        _line(exposure, lit_v),
        *_edges(windows),
        *_damping(grown_v),
        *_dark(rng),
        *_bright(bright),
        _correlated(found, calculated),
        _clock_step(),
    ]
    panels = [
        _line_panel(exposure, lit_v, error_v),
        _window_panel(windows),
        _growth_panel(grown_v),
        _bright_panel(bright),
        _correlation_panel(delays_s, found, calculated),
        _bit_pattern_panel(),
    ]
    return Study("pulsed-sensor", "König 2008, 4.2.1, 4.2.3.1 and 4.2.3.2", claims, panels)


def _bench() -> PulsedCamera:
    """Return the camera before a plane target, with a first window that holds all of the pulse."""
    camera = replace(measured_edges(PulsedCamera()), shutter_delay_s=-100e-9, shutter_a_width_s=400e-9)
    return replace(camera, pixel=replace(camera.pixel, accumulations=(1,)))


def _values(camera: PulsedCamera, name: str, rng: np.random.Generator) -> Floats:
    """Return the values of one window, V (N,), of pixels that see the target."""
    many, view = targets_on_axis([AT_M], REFLECTIVITY, camera, _ROWS)
    values: Floats = np.ravel(simulate(looking_at(view), many, 0.0, rng).planes[name]).astype(np.float64)
    return values


def _irradiance(camera: PulsedCamera) -> float:
    """Return what the peak of the pulse makes on the sensor, W/m2."""
    one = np.ones(1)
    power_w = camera.laser.peak_power_w
    return float(irradiance_on_sensor(power_w, AT_M * one, REFLECTIVITY * one, one, one, camera.objective)[0])


def _responsivity(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return exposures by the reference diode, J/m2, mean signals and their standard errors, V (K-CHR-01).

    The diode beside the camera, behind the same lens, integrates the irradiance over the pulse (eqs 4.12, 4.14).
    """
    at_s = np.linspace(-100e-9, 400e-9, 5001)
    rows = []
    for power_w in np.linspace(60.0, 900.0, 10):
        camera = replace(_bench(), laser=Laser(peak_power_w=float(power_w)))
        values_v = _values(camera, "shutter_a", rng)
        by_diode = float(np.trapezoid(_irradiance(camera) * pulse_shape(at_s, camera), at_s))
        rows.append((by_diode, values_v.mean(), values_v.std() / np.sqrt(_ROWS)))
    exposure, mean_v, error_v = np.array(rows).T
    return exposure, mean_v, error_v


def _line(exposure: Floats, lit_v: Floats) -> Claim:
    line = np.polyfit(exposure, lit_v, 1)
    off_v = float(np.abs(np.polyval(line, exposure) - lit_v).max())
    why = f"within 0.5 %; the points leave the line by {off_v * 1e3:.2f} mV at most"
    agrees = abs(line[0] / RESPONSIVITY - 1) < 0.005 and off_v < 1e-3
    text = "responsivity: slope of the line through ten illuminations"
    return judged("F-K-01", text, RESPONSIVITY, line[0], "V/(J/m2)", agrees, why)


def _sampled_shutter(width_s: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return arrivals of pulses of 100 ps, s, and signals over their largest, of a window (K-CHR-02)."""
    camera = replace(
        _bench(),
        pulse_width_s=DIRAC_S,
        pulse_rise_s=0.0,
        pulse_fall_s=0.0,
        shutter_delay_s=0.0,
        shutter_a_width_s=width_s,
        laser=Laser(peak_power_w=5e5),
        shutters="a_delayed",
        delay_first_s=-120e-9,
        delay_step_s=_STEP_S,
        delay_count=int((width_s + 180e-9) / _STEP_S),
    )
    many, view = targets_on_axis([AT_M], REFLECTIVITY, camera, 50)
    planes = simulate(looking_at(view), many, 0.0, rng).planes
    values = np.array([planes[f"shutter_a_{k}"].mean(dtype=np.float64) for k in range(camera.delay_count)])
    arrival_s = camera.delay_first_s + _STEP_S * np.arange(camera.delay_count) + 2 * AT_M / camera.speed_of_light_mps
    return arrival_s, values / values.max()


def _edges(windows: dict[float, tuple[Floats, Floats]]) -> list[Claim]:
    """Return how long before the switch the windows rise and fall, and how flat they are between."""
    claims = []
    for width_s, (at_s, part) in windows.items():
        rises_s = -float(at_s[np.flatnonzero(part > 0.02)[0]])
        falls_s = width_s - float(at_s[np.flatnonzero(part > 0.98)[-1]])
        soft = 55e-9 < rises_s < 75e-9 and 55e-9 < falls_s < 75e-9
        name = f"shutter of {width_s * 1e9:g} ns"
        why = "60-70 ns, whatever the length"
        claims.append(judged("F-K-02", f"{name}: rises before it opens by", 65, rises_s * 1e9, "ns", soft, why))
        claims.append(judged("F-K-02", f"{name}: falls before it closes by", 65, falls_s * 1e9, "ns", soft, why))
        flat = part[(at_s > 0) & (at_s < width_s - 75e-9)]
        if flat.size > 1:
            ripple = 100 * float(flat.max() - flat.min())
            claims.append(judged("F-K-02", f"{name}: ripple between", 0, ripple, "%", ripple < 2, "below 2 %, noise"))
    return claims


def _counting(n: int, full_part: float) -> PulsedCamera:
    """Return the bench with `n` accumulations and light that 100 of them bring to `full_part` V."""
    camera = _bench()
    single_v = full_part / 51.6
    exposure = single_v / RESPONSIVITY
    power_w = camera.laser.peak_power_w * exposure / (_irradiance(camera) * camera.pulse_width_s)
    pixel = replace(camera.pixel, accumulations=(n,))
    return replace(camera, pixel=pixel, laser=Laser(peak_power_w=power_w))


def _damping(grown_v: Floats) -> list[Claim]:
    """Return the damping that is fitted to accumulated signals (eqs 4.17-4.18; K-CHR-03)."""
    n = np.array(_PULSES, np.float64)

    def model(n: Floats, single_v: float, loss: float) -> Floats:
        return np.asarray(single_v * np.expm1(-loss * n) / np.expm1(-loss))

    fitted, covariance = curve_fit(model, n, grown_v, (grown_v[0], 0.01))
    loss, error = float(fitted[1]), float(np.sqrt(covariance[1, 1]))
    concave = bool(np.all(np.diff(np.diff(grown_v) / np.diff(n)) < 0))
    below = 100 * float(grown_v[-1] / (100 * fitted[0]))
    why = f"within 2 %; standard error {error:.1g}"
    agrees = abs(loss / DAMPING - 1) < 0.02
    return [
        judged("F-K-03", "damping fitted to 1-100 accumulations", DAMPING, loss, "", agrees, why),
        judged("F-K-03", "signal of 100 accumulations over 100 of one", 51.6, below, "%", concave, "concave"),
    ]


def _dark(rng: np.random.Generator) -> list[Claim]:
    """Return that dark noise does not depend on the length of the shutter (K-CHR-08, F-K-07)."""
    sigmas_v, values_v = [], np.empty(0)
    for width_s in SHUTTERS_S:
        camera = replace(_counting(16, 1.0), shutter_a_width_s=width_s, pulse_rise_s=0.0, pulse_fall_s=0.0)
        camera = replace(camera, pixel=replace(camera.pixel, adc_bits=0))
        many, view = targets_on_axis(np.full(_COLUMNS, AT_M), 0.0, camera, _ROWS)
        values_v = np.ravel(simulate(looking_at(view), many, 0.0, rng).planes["shutter_a"]).astype(np.float64)
        sigmas_v.append(float(values_v.std()))
    spread = 100 * (max(sigmas_v) / min(sigmas_v) - 1)
    near = 100 * 5 / np.sqrt(2 * _COLUMNS * _ROWS)
    text = "dark noise at 16 accumulations, 90-390 ns: largest over least less one"
    claims = [
        derived("F-K-07", "dark noise at 16 accumulations", 1e3 * sigmas_v[0], "mV"),
        judged("F-K-07", text, 0, spread, "%", spread < near, "five standard errors: independent of the length"),
    ]
    for k, table in ((1, 0.683), (2, 0.954), (3, 0.997)):
        share = float(np.mean(np.abs(values_v - values_v.mean()) < k * sigmas_v[-1]))
        agrees = abs(share - table) < 4 * np.sqrt(table * (1 - table) / values_v.size) + 5e-4
        why = "table B.1, within four standard errors and its last digit"
        claims.append(judged(f"N-K-084.{k}", f"dark values within {k} sigma", table, share, "", agrees, why))
    return claims


def _bright_noise(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return signals and noise of 16 accumulations, V, at powers that are tuned to the signal (K-NOI-07)."""
    rows = []
    for part in np.linspace(0.2, 1.4, 7):
        camera = _counting(16, part * 51.6 / 14.3)
        many, view = targets_on_axis(np.full(_COLUMNS, AT_M), REFLECTIVITY, camera, _ROWS)
        values_v = simulate(looking_at(view), many, 0.0, rng).planes["shutter_a"].astype(np.float64)
        rows.append((values_v.mean(), values_v.std()))
    signal_v, sigma_v = np.array(rows).T
    return signal_v, sigma_v


def _bright(bright: tuple[Floats, Floats]) -> list[Claim]:
    signal_v, sigma_v = bright
    line = np.polyfit(signal_v, sigma_v**2, 1)
    rise = 100 * (float(np.sqrt(np.polyval(line, 1.5) / line[1])) - 1)
    why = "within 1.5 %: hardly more than in darkness"
    text = "rise of the noise from darkness to 1.5 V, n = 16"
    return [judged("F-K-09", text, 2.7, rise, "%", abs(rise - 2.7) < 1.5, why)]


def _correlation(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return delays, s, and the signal over its top, measured and calculated: 180 ns in 390 ns (K-CHR-09)."""
    camera = replace(
        _bench(),
        shutter_delay_s=0.0,
        shutter_a_width_s=390e-9,
        laser=Laser(peak_power_w=500.0),
        shutters="a_delayed",
        delay_first_s=-320e-9,
        delay_step_s=_STEP_S,
        delay_count=150,
    )
    many, view = targets_on_axis([AT_M], REFLECTIVITY, camera, 50)
    planes = simulate(looking_at(view), many, 0.0, rng).planes
    found = np.array([planes[f"shutter_a_{k}"].mean(dtype=np.float64) for k in range(camera.delay_count)])
    delays_s = camera.delay_first_s + _STEP_S * np.arange(camera.delay_count)
    arrival_s = delays_s + 2 * AT_M / camera.speed_of_light_mps
    curve = correlation_curve(shutter_windows(quiet(camera))["a"], camera)
    calculated = np.interp(arrival_s, *curve)
    return delays_s, found / found.max(), calculated / calculated.max()


def _correlated(found: Floats, calculated: Floats) -> Claim:
    off = 100 * float(np.abs(found - calculated).max())
    text = "correlation of 180 ns and 390 ns, measured less calculated, of the top: largest"
    return judged("F-K-10", text, 0, off, "%", off < 1, "below 1 %")


def _line_panel(exposure: Floats, lit_v: Floats, error_v: Floats) -> Panel:
    line = np.polyval(np.polyfit(exposure, lit_v, 1), exposure)
    series = [
        Series("line", 1e6 * exposure, line, line="--"),
        Series("measured, ±2σ", 1e6 * exposure, lit_v, error_v),
    ]
    return Panel("Responsivity, 905 nm", "exposure (µJ/m²)", "signal (V)", series)


def _window_panel(windows: dict[float, tuple[Floats, Floats]]) -> Panel:
    series = [Series(f"{width_s * 1e9:g} ns", at_s * 1e9, part) for width_s, (at_s, part) in windows.items()]
    return Panel("Shutter sampled by pulses of 100 ps", "after the switch closes (ns)", "signal over its top", series)


def _growth_panel(grown_v: Floats) -> Panel:
    n = np.array(_PULSES)
    series = [
        Series("measured", n, grown_v, line="o-"),
        Series("without damping", n, n * grown_v[0], line="--"),
    ]
    return Panel("Accumulation", "accumulations", "signal (V)", series)


def _bright_panel(bright: tuple[Floats, Floats]) -> Panel:
    signal_v, sigma_v = bright
    error_v = sigma_v / np.sqrt(2 * _COLUMNS * _ROWS)
    series = [Series("measured, ±2σ", signal_v, 1e3 * sigma_v, 1e3 * error_v)]
    return Panel("Noise in the light, n = 16", "signal (V)", "standard deviation (mV)", series)


def _correlation_panel(delays_s: Floats, found: Floats, calculated: Floats) -> Panel:
    series = [
        Series("calculated", delays_s * 1e9, calculated),
        Series("measured", delays_s[::4] * 1e9, found[::4], line="o", colour=1),
    ]
    return Panel("Pulse of 180 ns, shutter of 390 ns", "laser delay (ns)", "signal over its top", series)


def _clock_step() -> Claim:
    """Return by how much the range moves when the bit pattern opens the shutter one step later."""
    sequencer = Sequencer()
    opened_s = [execute(table_of((k * _CLOCK_S, 6 * _CLOCK_S), sequencer), _CLOCK_S).window_s[0] for k in (0, 1)]
    moved_m = 3e8 / 2 * (opened_s[1] - opened_s[0])
    return derived(
        "N-K-093", "range of one step of the bit pattern", moved_m, "m", "finer shifts need the laser's delay"
    )


def _bit_pattern_panel() -> Panel:
    """Draw the control table of one pulse: laser on, transfer of four pixels, laser off, and again."""
    table = table_of((0.0, 6 * _CLOCK_S), Sequencer())
    time_ns = np.arange(len(table[0]) + 1) * _CLOCK_S * 1e9
    levels = [np.array([*map(int, row), int(row[-1])]) for row in table]
    series = [
        Series(name, np.repeat(time_ns, 2)[1:-1], np.repeat(0.7 * level[:-1] + 7 - row, 2))
        for row, (name, level) in enumerate(zip(SIGNALS, levels, strict=True))
    ]
    return Panel("Bit pattern of a window of 180 ns", "time (ns)", "level, one above the other", series)
