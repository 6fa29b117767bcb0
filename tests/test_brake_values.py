"""States and messages of the safety core: who holds one can rely on it."""

import dataclasses
from types import ModuleType

import pytest

from rangecam.brake import friction, gate, health, machine, unit
from rangecam.can import codec


@pytest.mark.parametrize("module", [machine, gate, health, friction, unit, codec])
def test_nothing_in_the_safety_core_can_be_changed_afterwards(module: ModuleType) -> None:
    made = [each for each in vars(module).values() if isinstance(each, type) and dataclasses.is_dataclass(each)]
    assert made
    for each in made:
        thing = object.__new__(each)
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(thing, next(iter(vars(each).get("__annotations__", ())), "other"), 1)
