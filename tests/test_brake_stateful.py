"""The decision unit with its settings of every day, driven at random: any input at any time, a car that obeys.

The exploration walks all states in whole ticks with small timeouts; here times and speeds are any numbers, the settings
are the defaults, and what is judged are the bytes on the bus. Hypothesis searches for a sequence that breaks a claim.
"""

import math

from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from rangecam.brake.gate import CanFrame, arm
from rangecam.brake.machine import CarState, Fault, Inputs, Mode, Perception
from rangecam.brake.unit import BrakeSettings, Unit, step
from rangecam.can.layout import BRAKE_MODE, GIVE_BACK_DATA, MAGIC, MASTER_ID, VALUE_PER_UNIT

SETTINGS = BrakeSettings()
MACHINE = SETTINGS.machine
LONGEST_STEP_S = 0.02
"""The unit is called at least so often."""
PERIOD_S = 1 / 30
SICK = [fault for fault in Fault if fault not in (Fault.STARTING, Fault.NO_IMAGE, Fault.NO_CAR_STATE)]
TOP_MPS = 4.0
DECELERATION_MPS2 = 5.0


def brakes(frame: CanFrame | None) -> bool:
    return frame is not None and frame.data[0] == BRAKE_MODE


class Drive(RuleBasedStateMachine):
    """A camera, a car and their faults, in front of one decision unit."""

    def __init__(self) -> None:
        super().__init__()
        self.unit = Unit(gate=arm(Unit().gate))
        self.time_s, self.speed_mps, self.frame_id = 100.0, 0.0, 0
        self.perception: Perception | None = None
        self.car: CarState | None = None
        self.good_image_s = self.good_car_s = -math.inf
        self.demanded_s = -math.inf
        self.frame: CanFrame | None = None
        self.mode_before = Mode.FAULT
        self.braked = False

    def image(self, brake: bool, faults: tuple[Fault, ...] = (), back: int = 0, ahead_s: float = 0.0) -> None:
        self.frame_id += 1
        number = self.frame_id - back
        self.perception = Perception(number, number * PERIOD_S, self.time_s + ahead_s, brake, "box", faults)

    @initialize(under_way=st.booleans())
    def starts(self, under_way: bool) -> None:
        """Half of the drives begin as a fault, the others under way."""
        if under_way:
            for k in range(150):
                self.pass_by(LONGEST_STEP_S, k > 75, True, True)
            assert self.unit.state.mode is Mode.USER_CONTROL

    @rule(brake=st.booleans())
    def sees(self, brake: bool) -> None:
        """A good image comes."""
        self.image(brake)
        self.good_image_s = self.time_s
        if brake:
            self.demanded_s = self.time_s

    @rule(fault=st.sampled_from(SICK))
    def sees_badly(self, fault: Fault) -> None:
        """An image comes that is not to be trusted, and demands braking."""
        self.image(True, (fault,))

    @rule(back=st.integers(1, 5))
    def sees_the_past(self, back: int) -> None:
        """An image comes again, or late; in a fault it may be that of a camera that has begun anew."""
        if self.unit.state.mode is not Mode.FAULT and self.good_image_s > -math.inf:
            self.image(True, back=back)
            self.frame_id -= 1

    @rule(ahead_s=st.floats(0.001, 10.0))
    def sees_the_future(self, ahead_s: float) -> None:
        """An image comes whose stamp is not of now."""
        self.image(True, ahead_s=ahead_s)

    @rule()
    def hears(self) -> None:
        """The car says how fast it is."""
        if self.car is None or self.time_s > self.car.received_s:
            self.car = CarState(self.speed_mps, self.time_s)
            self.good_car_s = self.time_s

    @rule(speed_mps=st.sampled_from([math.nan, math.inf, -1.0, 100.0]))
    def hears_nonsense(self, speed_mps: float) -> None:
        """The car says what no car can say."""
        self.car = CarState(speed_mps, self.time_s)

    @rule(seconds=st.floats(0.001, LONGEST_STEP_S), gas=st.booleans(), images=st.booleans(), cars=st.booleans())
    def drives(self, seconds: float, gas: bool, images: bool, cars: bool) -> None:
        """Some time passes; the driver accelerates or not, unless the unit brakes."""
        self.pass_by(seconds, gas, images, cars)

    @rule(count=st.integers(1, 12), gas=st.booleans(), images=st.booleans(), cars=st.booleans())
    def drives_on(self, count: int, gas: bool, images: bool, cars: bool) -> None:
        """The same for longer."""
        for _ in range(count):
            self.pass_by(LONGEST_STEP_S, gas, images, cars)

    def pass_by(self, seconds: float, gas: bool, images: bool, cars: bool) -> None:
        rate = -DECELERATION_MPS2 if self.braked else 3.0 if gas else 0.0
        self.speed_mps = min(TOP_MPS, max(0.0, self.speed_mps + rate * seconds))
        self.time_s += seconds
        if images:
            self.sees(False)
        if cars:
            self.hears()
        self.think()

    def think(self) -> None:
        self.mode_before = self.unit.state.mode
        self.unit, _, self.frame = step(self.unit, Inputs(self.time_s, self.perception, self.car), SETTINGS)
        self.braked = brakes(self.frame) or (self.braked and self.frame is None)
        if self.frame is not None and self.frame.data == GIVE_BACK_DATA:
            self.braked = False
        self.check()

    def check(self) -> None:
        """Hold what was sent against the truth."""
        stale = self.time_s - self.good_image_s > MACHINE.image_timeout_s
        stale |= self.time_s - self.good_car_s > MACHINE.car_timeout_s
        assert brakes(self.frame) or not stale
        if self.unit.state.mode is Mode.STOPPING and self.mode_before is not Mode.STOPPING:
            assert self.demanded_s == self.good_image_s  # the newest good image demanded it
            assert self.time_s - self.demanded_s <= MACHINE.image_timeout_s
        if self.unit.state.mode is Mode.USER_CONTROL and self.mode_before is not Mode.USER_CONTROL:
            assert self.speed_mps <= MACHINE.standstill_mps
        assert self.unit.gate.refused == {}

    @invariant()
    def sends_nothing_but_braking_and_give_back(self) -> None:
        """Whatever is sent can only slow the car down, or give it back."""
        if self.frame is None or self.frame.data == GIVE_BACK_DATA:
            return
        mode, low, high, *others = self.frame.data
        assert (self.frame.can_id, mode, others[:3], bytes(others[3:])) == (MASTER_ID, BRAKE_MODE, [0] * 3, MAGIC)
        assert 0 < low + 256 * high <= VALUE_PER_UNIT

    def teardown(self) -> None:
        """Whatever happened, good input and a standing car give control back."""
        for _ in range(200):
            self.pass_by(LONGEST_STEP_S, False, True, True)
        assert self.unit.state.mode is Mode.USER_CONTROL
        assert not brakes(self.frame)


TestDrive = Drive.TestCase
TestDrive.settings = hypothesis_settings(max_examples=60, stateful_step_count=40, deadline=None, derandomize=True)
