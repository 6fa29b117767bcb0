"""The three processing units of the microcontroller: timing, frame rates and memories; and what the stream takes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from rangecam.embedded.linker import LINKER, disagreements, misplaced, overlaps
from rangecam.embedded.memory import KBYTE, MEMORIES, placements
from rangecam.embedded.partition import repartitioned
from rangecam.embedded.results import analyse, frame_rate_bound_hz, highest_frame_rate_hz, slots_in_use
from rangecam.embedded.scheduler import Timeline, run_schedule
from rangecam.embedded.settings import Schedule, Task, capture_time_s, load_schedule
from rangecam.io.udp.packets import PACKET_BYTES, frame_packets, payload_mbit, wire_mbit
from rangecam.studies.study import Claim, Panel, Series, Study, derived, judged, printed

_FRAMES = 40
_PIXEL_CLOCK_HZ = 66.6e6
_KMH20 = 20 / 3.6


def embedded_schedule(rng: np.random.Generator) -> Study:
    """Three processing units in time: the frame rate that CPU 1 limits, one that an even share allows, latency, load.

    rng: draws how long the search for objects takes.
    """
    thesis = load_schedule("thesis")
    shared = repartitioned(thesis)
    at_30, at_60 = (
        run_schedule(thesis, _FRAMES, rng),
        run_schedule(replace(shared, frame_rate_hz=60.0), _FRAMES),
    )
    claims = [*_read_out(thesis), *_limits(thesis, shared), *_at_work(thesis, at_30, at_60)]
    panels = [
        _pins("As in the thesis, 30 frames/s", at_30, 2),
        _pins("Shared evenly, no debug data, 60 frames/s", at_60, 4),
        _over_rate(thesis, shared),
    ]
    return Study("embedded-schedule", "Steinbäck 2016, 4.3.3, 4.4 and 5.3.4", claims, panels)


def _read_out(thesis: Schedule) -> list[Claim]:
    """Return what the read-out of phase images takes, and the frame rates and motion that follow (N-S-018, 019)."""
    row_clocks = thesis.readout_time_s * _PIXEL_CLOCK_HZ / thesis.rows
    claims = [derived("N-S-018", "pixel clocks per row in the measured 1.23 ms", row_clocks, "", "160 pixels (E-S-14)")]
    for number, light_s in ((1, 1e-3), (2, 2e-3)):
        lit = replace(thesis, illumination_time_s=light_s)
        way_m = _KMH20 * (capture_time_s(lit) - lit.readout_time_s)
        text = f"illumination {light_s * 1e3:.0f} ms:"
        claims += [
            derived(f"N-S-019.{number}", f"{text} frames a second at most", 1 / capture_time_s(lit), "Hz"),
            derived(f"N-S-019.{number}", f"{text} way at 20 km/h during the exposures", way_m * 1e3, "mm"),
        ]
    return claims


def _limits(thesis: Schedule, shared: Schedule) -> list[Claim]:
    """Return the frame rates up to which all deadlines are met."""
    cycles = thesis.clock_hz / (thesis.rows * thesis.columns)
    first_s = sum(task.time_s for task in thesis.tasks if task.unit == 1)
    limit, even = highest_frame_rate_hz(thesis), highest_frame_rate_hz(shared)
    earlier = highest_frame_rate_hz(load_schedule("earlier-platform"))
    chain_s = sum(task.time_s + task.spread_s for task in thesis.tasks if not task.optional and task.after)
    allowed_s = 3 / 60 - first_s
    return [
        judged("N-S-034", "frames a second, deadlines met", 35, limit, "Hz", abs(limit - 35) < 0.5, _ABOUT_35),
        derived("N-S-034", "cycles a pixel at 35 frames a second", cycles / 35, ""),
        derived("N-S-034", "cycles a pixel at the required 25 frames a second", cycles / 25, ""),
        judged("N-S-034", "frames a second, shared evenly, no debug data", 60, even, "Hz", even >= 60, _AT_LEAST_60),
        derived("N-S-034", "the same, were the stages divisible", 3 / chain_s, "Hz", "three units, none ever idle"),
        derived("N-S-034", "CPU 2 may take this long for 60 Hz to be possible", allowed_s * 1e3, "ms", _RELATIVELY_LOW),
        judged("N-S-046", "highest frame rate by the conclusion", 30, limit, "Hz", False, _THREE_NUMBERS),
        judged("S-CPU-09", "earlier platform, frames a second", 80, earlier, "Hz", abs(earlier - 80) < 2, _EARLIER),
    ]


_ABOUT_35 = "'about 35': the time of CPU 1 follows from it, the simulation finds it again"
_AT_LEAST_60 = "'at least 60', by moving stages alone; how CPU 1's time divides into stages is open"
_RELATIVELY_LOW = "of 28.6 ms that CPU 1 takes; its utilisation is called relatively low"
_THREE_NUMBERS = "more than 30 in the abstract, up to 30 in the conclusion, about 35 in 5.3.4 (E-S-26): 35 is the limit"
_EARLIER = "'up to 80': by the exposures of 1.85 ms that allow it; times of its two tasks are open"


def _at_work(thesis: Schedule, at_30: Timeline, at_60: Timeline) -> list[Claim]:
    """Return loads, latencies and buffers at the operating point."""
    found, fast = analyse(at_30), analyse(at_60)
    full = _full_pipeline(thesis)
    slots = list(slots_in_use(run_schedule(full, _FRAMES)).values())
    claims = [
        derived("S-RES-05", f"CPU {n} busy at 30 frames a second", 100 * load, "%", "times of CPU 0 and 2 are open")
        for n, load in found.unit_load.items()
    ]
    why = "a stage as long as the frame period keeps its data until the third has collected them"
    claims += [
        judged("N-S-049", f"buffers of stage {k + 1} of 3", 3 - k, slots[k], "", slots[k] == 3 - k, why)
        for k in range(3)
    ]
    return [
        *claims,
        derived("S-RES-05", "exposure to decision at 30 frames a second", 1e3 * max(found.latency_s), "ms"),
        derived("S-RES-05", "the same at 60, shared evenly", 1e3 * max(fast.latency_s), "ms"),
    ]


def _full_pipeline(thesis: Schedule) -> Schedule:
    """Return a chain of three stages that take the whole frame period each (less a nanosecond, to be done in time)."""
    time_s = 1 / thesis.frame_rate_hz - 1e-9
    names = ("camera", "CPU 1", "CPU 2", "CPU 0")
    pairs = enumerate(pairwise(names))
    tasks = tuple(Task(name=name, unit=k, time_s=time_s, after=before) for k, (before, name) in pairs)
    return replace(thesis, tasks=tasks)


def _pins(title: str, timeline: Timeline, n_frames: int) -> Panel:
    """Return the tasks as a logic analyser shows their pins (fig 5.14): high while they run."""
    rate_hz = timeline.schedule.frame_rate_hz
    start = 10 / rate_hz
    window = (start, start + n_frames / rate_hz)
    series = []
    for row, task in zip(reversed(range(len(timeline.schedule.tasks))), timeline.schedule.tasks, strict=True):
        x, y = [0.0], [float(row)]
        for span in timeline.spans:
            if span.job.task is task and span.end_ns / 1e9 > window[0] and span.start_ns / 1e9 < window[1]:
                a, b = (1e3 * (min(max(at / 1e9, window[0]), window[1]) - start) for at in (span.start_ns, span.end_ns))
                x += [a, a, b, b]
                y += [row, row + 0.7, row + 0.7, row]
        x.append(1e3 * (window[1] - start))
        y.append(float(row))
        series.append(Series(f"CPU {task.unit}: {task.name}", x, y, colour=task.unit))
    return Panel(title, "time (ms)", "task (from below)", series)


def _over_rate(thesis: Schedule, shared: Schedule) -> Panel:
    """Return the share of frames that are lost or late over the frame rate."""
    series = []
    for label, schedule in (("as in the thesis", thesis), ("shared evenly", shared)):
        rates = np.linspace(20, min(76.0, 1.2 * frame_rate_bound_hz(schedule)), 15)
        bad = [100 * _faulty(run_schedule(replace(schedule, frame_rate_hz=float(r)), _FRAMES)) for r in rates]
        series.append(Series(label, rates, bad))
    return Panel("Frames lost or too late", "frame rate (Hz)", "frames (%)", series)


def _faulty(timeline: Timeline) -> float:
    period_ns = 1e9 / timeline.schedule.frame_rate_hz
    late = {job.frame for job in timeline.jobs if job.ended_ns and job.ended_ns - job.released_ns > period_ns}
    lost = {frame for frame, each in enumerate(analyse(timeline).latency_s) if np.isnan(each)}
    return len(late | lost) / timeline.n_frames


def embedded_memory(rng: np.random.Generator) -> Study:
    """Memories of the microcontroller: what fits where, the linker's map, and data rates of the debug stream."""
    thesis = load_schedule("thesis")
    image = thesis.rows * thesis.columns * 2
    rows = placements(thesis)
    sizes = {memory.name: int(memory.kbytes * KBYTE) for memory in MEMORIES}
    local = [LINKER["DMI_DSPR"].length + LINKER[f"DMI_DSPR{n}_EX"].length for n in range(3)]
    tables = "as in table 3.2, and the exclusive part begins right behind the shared one"
    there, here = disagreements()["DFLASH"]
    wrong = len(overlaps()) + len(misplaced())
    two_pages = "table 3.2 beside 1M + 16K + 64K of the linker's map (E-S-23)"
    claims = [
        printed("N-S-007", "bytes of an image", "38400", image, "byte"),
        printed("N-S-007", "bytes of four phase images", "153600", 4 * image, "byte"),
        judged(
            "N-S-032",
            "images that the shared LMU memory holds",
            0,
            sizes["LMU"] // image,
            "",
            sizes["LMU"] < image,
            "'cannot fit a full 16 bit image'",
        ),
        derived("N-S-032", "images that the local memory of CPU 1 or 2 holds", sizes["DSPR1"] / image, ""),
        derived("N-S-032", "memories whose buffers do not fit", sum(not row.fits for row in rows), "", _BUFFERS),
        *(
            judged("N-S-033", f"local memory of CPU {n}", k, size / KBYTE, "KByte", size == k * KBYTE, tables)
            for n, (k, size) in enumerate(zip((120, 240, 240), local, strict=True))
        ),
        judged("N-S-033", "regions that overlap or begin at a wrong address", 0, wrong, "", not wrong, "listing A.2"),
        judged("N-S-033", "data flash", 768, there / KBYTE, "KByte", there == here, two_pages),
    ]
    for rate, text in ((10, "12.29"), (20, "24.58"), (30, "36.86"), (40, "49.15")):
        mbit = payload_mbit(4 * image // PACKET_BYTES, rate)
        claims.append(
            printed(f"N-S-008.{rate}", f"data rate of phase images at {rate} frames a second", text, mbit, "Mbit/s")
        )
    for images in (4, 2, 1, 0):
        packets = frame_packets(images)
        text = f"{images} images a frame:"
        claims += [
            derived(f"N-S-009.{images}", f"{text} packets", packets, ""),
            derived(f"N-S-009.{images}", f"{text} on the wire at 30 frames a second", wire_mbit(packets, 30), "Mbit/s"),
        ]
    return Study("embedded-memory", "Steinbäck 2016, 3.3.3, 3.6, 4.3.4, 4.4.3 and A.9", claims, _memory_panels(thesis))


_BUFFERS = "of the buffers that 4.4.3 and 4.4.4 name; how many images are at work in each is open"


def _memory_panels(thesis: Schedule) -> list[Panel]:
    rows = [row for row in placements(thesis) if row.used]
    names = ", ".join(f"{k}: {row.memory}" for k, row in enumerate(rows))
    places = np.arange(len(rows))
    used = [
        Series("there", places, [row.size for row in rows], line="s"),
        Series("used", places, [row.used for row in rows], line="o"),
    ]
    rates = np.linspace(1, 100, 50)
    words = ("words alone", "range", "real and imaginary", None, "four phase images")
    lines = [
        Series(f"{label}, {frame_packets(n)} packets", rates, [wire_mbit(frame_packets(n), float(r)) for r in rates])
        for n, label in enumerate(words)
        if label
    ]
    lines += [Series(f"{mbit} Mbit/s Ethernet", rates, np.full(rates.shape, mbit), line="--") for mbit in (10, 100)]
    return [
        Panel("Memories", names, "bytes", used, log="y"),
        Panel("The stream on the wire", "frame rate (Hz)", "Mbit/s", lines, log="y"),
    ]
