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
    """Make `cls` a frozen, keyword-only, hashable dataclass whose unknown keys and impossible values are errors."""
    rules: dict[str, Any] = {"extra": "forbid", "use_attribute_docstrings": True, "allow_inf_nan": False}
    cls.__pydantic_config__ = rules  # type: ignore[attr-defined]  # read by pydantic in config.py only
    return dataclass(frozen=True, kw_only=True)(cls)
