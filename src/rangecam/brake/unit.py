"""The decision unit: machine, gate and friction in one step. What calls it owns the clock and the bus."""

from rangecam.brake.friction import Friction, FrictionSettings, observe
from rangecam.brake.gate import CanFrame, Gate, GateSettings, let_pass
from rangecam.brake.health import HealthSettings
from rangecam.brake.machine import BrakeState, Inputs, MachineSettings, Mode, Request, advance
from rangecam.errors import UsageError
from rangecam.settings import settings
from rangecam.values import record


@settings
class BrakeSettings:
    """The emergency brake: health of the input, states, gate, friction."""

    health: HealthSettings = HealthSettings()
    machine: MachineSettings = MachineSettings()
    gate: GateSettings = GateSettings()
    friction: FrictionSettings = FrictionSettings()

    def __post_init__(self) -> None:
        """Refuse a gate that would fall silent in the middle of a stop."""
        if not self.gate.cause_age_s > self.machine.image_timeout_s:
            raise UsageError(
                f"gate.cause_age_s = {self.gate.cause_age_s:g}: must exceed machine.image_timeout_s = "
                f"{self.machine.image_timeout_s:g}, or the gate would refuse a stop that the machine holds"
            )


@record
class Unit:
    """The memory of the decision unit. It starts with a closed gate (`gate.arm` opens it) and as a fault."""

    state: BrakeState = BrakeState()
    gate: Gate = Gate()
    friction: Friction = Friction()


def step(unit: Unit, inputs: Inputs, settings: BrakeSettings) -> tuple[Unit, Request, CanFrame | None]:
    """Return the unit after a step, what the machine asked for, and the frame to send now, if any.

    To be called for every new image, every new car state and at least every 20 ms (S-DEC-01).
    """
    state, request = advance(unit.state, inputs, settings.machine)
    gate, frame = let_pass(unit.gate, request, inputs.time_s, settings.gate)
    stopping = state.mode is Mode.STOPPING and frame is not None
    friction = observe(unit.friction, state.perception, state.speed_mps, stopping, settings.friction)
    return Unit(state, gate, friction), request, frame
