"""Pulse, shutter windows and their correlation: how much of a pulse each window collects."""

from rangecam.pulsed.settings import PulsedCamera


def shutter_windows(camera: PulsedCamera) -> dict[str, tuple[float, float]]:
    """Return when the windows a, b, c open and close, s: b opens when a closes, c spans both (König 2008, fig 3.6)."""
    opens = camera.shutter_delay_s
    middle = opens + (camera.shutter_a_width_s or camera.pulse_width_s)
    closes = middle + (camera.shutter_b_width_s or camera.pulse_width_s)
    return {"a": (opens, middle), "b": (middle, closes), "c": (opens, closes)}


def gate_windows(camera: PulsedCamera) -> dict[str, tuple[float, float]]:
    """Return when the gates 1, 2, 3 of a three-tap sensor open and close, s; time counts from the opening of gate 2."""
    width = camera.gate_width_s or camera.pulse_width_s
    return {str(i): ((i - 2) * width, (i - 1) * width) for i in (1, 2, 3)}
