"""How a module declares its settings: a frozen dataclass that `config.py` can validate.

Limits are written with `annotated_types` (`Annotated[float, Gt(0)]`), so that no module but `config.py` needs pydantic
and the limits reach error messages and the JSON schema alike. A string below a field is its description.
"""

from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, dataclass_transform

from annotated_types import Ge, Gt, Interval

T = TypeVar("T")

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Interval(ge=0, le=1)]
PositiveInt = Annotated[int, Gt(0)]
NonNegativeInt = Annotated[int, Ge(0)]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def settings(cls: type[T]) -> type[T]:
    """Make `cls` a frozen, keyword-only, hashable dataclass whose unknown keys and impossible values are errors.

    Settings are the keys of caches that every frame asks, so an instance computes its hash once.
    """
    rules: dict[str, Any] = {"extra": "forbid", "use_attribute_docstrings": True, "allow_inf_nan": False}
    cls.__pydantic_config__ = rules  # type: ignore[attr-defined]  # read by pydantic in config.py only
    made: Any = dataclass(frozen=True, kw_only=True)(cls)
    of_fields = made.__hash__

    def once(self: Any) -> int:
        try:
            known: int = self._hash
        except AttributeError:
            known = self.__dict__["_hash"] = of_fields(self)
        return known

    def without_hash(self: Any) -> dict[str, Any]:  # strings hash differently in another process
        return {key: value for key, value in self.__dict__.items() if key != "_hash"}

    made.__hash__, made.__getstate__ = once, without_hash
    finished: type[T] = made
    return finished
