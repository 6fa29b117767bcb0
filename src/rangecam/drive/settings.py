"""What a drive is told beside its scene and its camera: vehicle, road, driver, latencies, faults."""

from typing import Literal

from rangecam.brake.unit import BrakeSettings
from rangecam.settings import NonNegative, Positive, settings
from rangecam.vehicle.settings import Vehicle

FaultKind = Literal[
    "frozen",
    "dropped",
    "late",
    "repeated",
    "out_of_order",
    "saturated",
    "status_silence",
    "command_silence",
    "wrong_magic",
    "speed_stuck",
    "slippery",
]


@settings
class Fault:
    """Something that goes wrong for a while."""

    kind: FaultKind
    """frozen: frames show the last image before the fault; dropped: no frame comes; late: frames come `value` seconds
    later; repeated: the last frame before the fault comes again and again; out_of_order: each second frame comes after
    the one behind it; saturated: every sample is at full scale; status_silence, command_silence: nothing that the
    vehicle (the perception) sends arrives; wrong_magic: take-overs arrive without their magic number; speed_stuck: the
    vehicle reports the speed that it had when the fault began; slippery: the friction of the road is `value`."""
    start_s: NonNegative = 0.0
    """When it begins."""
    duration_s: Positive = 1e9
    """How long it lasts."""
    value: NonNegative = 0.1
    """Delay in s, or friction."""


@settings
class DriveSettings:
    """One drive, beside scene and camera."""

    vehicle: Vehicle = Vehicle()
    friction: Positive = 0.3
    """Of the road, true: 0.3 PVC floor, 0.7 dry asphalt (Steinbäck 2016, 3.4.1)."""
    result_after_frames: Positive = 4.0
    """From the start of an exposure to the decision made of it, in frame periods: one to take it and three for the
    processors in turn (eq 4.1 corrected by E-S-06)."""
    driver: Literal["lets_go", "holds"] = "lets_go"
    """What the hand at the remote control does when the vehicle has been taken over: lets the throttle go, or holds
    the speed of the scenario whenever it may."""
    step_s: Positive = 0.005
    """Time between two looks at the bus."""
    run_in_s: Positive = 0.5
    """Before time 0 everything runs for so long at the scenario's first speed, so that camera and bus have begun."""
    stop_after_s: NonNegative = 0.3
    """The drive ends so long after it has come to a stop; not before `duration_s` of the scenario without one."""
    brake: BrakeSettings = BrakeSettings()
    """Health, state machine, gate; its timeout of images and the greatest speed follow from camera and vehicle."""
    missed_frames: NonNegative = 3.0
    """So many frame periods after an image should have come, the system does not work."""
    harmless: tuple[str, ...] = ()
    """Things whose names begin so are no collision: what is driven through."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong."""
