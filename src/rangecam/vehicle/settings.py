"""What a vehicle is: its size, its drive, brakes and tyres, its speed sensor, batteries and control unit."""

from typing import Annotated

from annotated_types import Interval

from rangecam.errors import UsageError, did_you_mean
from rangecam.settings import Fraction, NonNegative, Positive, settings

Angle = Annotated[float, Interval(gt=0, lt=90)]


@settings
class SpeedSensor:
    """A light barrier that counts the holes of a disc on the shaft of the wheels (Steinbäck 2016, fig 3.10)."""

    hole_m: Positive = 8e-3
    """Way of the wheels from hole to hole; *open*: 8 holes on a shaft that turns 6 times for 0.38 m of way."""
    tick_s: NonNegative = 16e-6
    """Step of the timer that measures the time between two holes; *open*: an 8-bit controller's at 16 MHz / 256."""
    timeout_s: Positive = 0.15
    """Without a hole for so long the vehicle is taken to stand."""


@settings
class Battery:
    """A battery whose voltage falls as it is discharged, with an inner resistance."""

    full_v: Positive = 7.5
    """Without load, charged (S-VEH-03)."""
    empty_v: Positive = 6.0
    """Without load, discharged."""
    capacity_ah: Positive = 2.3
    """Charge of the one for the motor; that of the electronics has 2.0 Ah."""
    inner_ohm: NonNegative = 0.03
    """*Open*: six cells of nickel and metal hydride of 5 mohm."""
    used: Fraction = 0.1
    """How much of the charge is gone at the start."""


@settings
class Unit:
    """The vehicle's own microcontroller on the bus (Steinbäck 2016, 4.3.1)."""

    status_period_s: Positive = 0.02
    """Time between two status messages; *open* (S-CAN-07)."""
    remote_period_s: Positive = 0.02
    """Time between two values of the remote control: a radio sends a pulse each 20 ms."""
    timeout_s: Positive = 0.2
    """Control by the bus ends so long after the last take-over (E-S-25); *open*."""


@settings
class Vehicle:
    """A vehicle with four wheels, driven by its shaft and braked on all wheels.

    The defaults are those of the 1/5-scale car (S-VEH-01); what its thesis does not say is *open*.
    """

    name: str = "1/5-scale car"
    length_m: Positive = 0.8
    """From bumper to bumper; *open*."""
    width_m: Positive = 0.4
    """Without mirrors; *open*."""
    height_m: Positive = 0.3
    """What is higher up is not hit; *open*."""
    front_m: float = 0.0
    """x of the front bumper; 0: the camera sits there."""
    clearance_m: NonNegative = 0.04
    """What is lower than this is driven over; *open*."""
    wheelbase_m: Positive = 0.5
    """From axle to axle; *open*."""
    max_steer_deg: Angle = 25.0
    """Of the front wheels; *open*."""
    mass_kg: Positive = 10.0
    """*Open*."""
    max_speed_mps: Positive = 20 / 3.6
    """Where the motor gives no force any more (S-VEH-01)."""
    drive_mps2: NonNegative = 2.5
    """Acceleration by full throttle from standstill; falls to none at `max_speed_mps`, as of a direct-current motor."""
    brake_mps2: Positive = 8.0
    """Deceleration by the brakes fully applied, if the tyres held; *open*: enough to lock the wheels."""
    brake_delay_s: NonNegative = 0.1
    """From the command to the first effect (S-VEH-05, eq 3.6)."""
    brake_rise_s: NonNegative = 0.05
    """From there to full force, evenly; *open*: a servo turns 60 degrees in 0.15 s."""
    antilock: bool = False
    """Whether the wheels are kept from locking, and from spinning."""
    driven_load: Annotated[float, Interval(gt=0, le=1)] = 0.5
    """Share of the weight on the driven axle: the grip of the motor."""
    wheel_inertia: Annotated[float, Interval(gt=0, lt=1)] = 0.05
    """Mass that the turning wheels and the motor are equivalent to, over that of the vehicle; *open*."""
    rolling_mps2: NonNegative = 0.3
    """Deceleration by rolling; *open*: 3 % of the weight."""
    drag_per_m: NonNegative = 0.005
    """Deceleration by the air over the square of the speed: density x area x coefficient / (2 mass)."""
    sensor: SpeedSensor = SpeedSensor()
    battery: Battery = Battery()
    motor_ohm: NonNegative = 0.08
    """Resistance of the motor's winding; *open*."""
    standby_w: NonNegative = 2.0
    """What the vehicle takes when the motor does not turn."""
    heating_k_per_w: tuple[NonNegative, NonNegative, NonNegative, NonNegative] = (3.0, 2.0, 0.5, 2.0)
    """How much warmer motor, motor control, battery and electronics become in the end for each watt lost; *open*."""
    unit: Unit = Unit()


VEHICLES: dict[str, Vehicle] = {
    "scaled_car": Vehicle(),
    "passenger_car": Vehicle(
        name="passenger car",
        length_m=4.3,
        width_m=1.8,
        height_m=1.5,
        clearance_m=0.12,
        wheelbase_m=2.6,
        max_steer_deg=35.0,
        mass_kg=1400.0,
        max_speed_mps=50.0,
        drive_mps2=4.0,
        brake_mps2=11.0,
        # hydraulic brakes: first effect after 0.1 s, full pressure 0.3 s later; what counts is 0.25 s
        brake_delay_s=0.1,
        brake_rise_s=0.3,
        antilock=True,
        driven_load=0.6,
        wheel_inertia=0.04,
        rolling_mps2=0.12,
        drag_per_m=1.2 * 0.65 / 2 / 1400,
        sensor=SpeedSensor(hole_m=2.0 / 48, tick_s=1e-6),
        battery=Battery(full_v=400.0, empty_v=320.0, capacity_ah=150.0, inner_ohm=0.1),
        motor_ohm=0.02,
        standby_w=400.0,
        heating_k_per_w=(5e-3, 1e-2, 2e-3, 0.1),
    ),
}
"""Vehicles by name."""


def vehicle_named(name: str) -> Vehicle:
    """Return the vehicle of that name; raises UsageError, with the names known, if there is none."""
    if name not in VEHICLES:
        raise UsageError(f"unknown vehicle '{name}'{did_you_mean(name, VEHICLES)}; vehicles: {', '.join(VEHICLES)}")
    return VEHICLES[name]
