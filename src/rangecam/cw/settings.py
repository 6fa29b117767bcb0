"""The settings of a cw camera: everything that simulation and ranging need to know of it."""

from typing import Literal

from rangecam.geometry import Lens
from rangecam.settings import PositiveInt, settings


@settings
class CwCamera:
    """A cw camera."""

    kind: Literal["cw"] = "cw"
    name: str = "generic"
    rows: PositiveInt = 120
    columns: PositiveInt = 160
    frame_rate_hz: float = 30.0
    lens: Lens = Lens()
