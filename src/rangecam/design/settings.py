"""What can be set about the experiment that judges a design."""

from typing import Annotated

from annotated_types import Ge, Interval, Len

from rangecam.settings import Fraction, NonNegative, Positive, settings


@settings
class Plan:
    """Targets that each pixel sees squarely, simulated many times, and what is asked of the ranges."""

    distances_m: tuple[Positive, ...] = ()
    """Ranges of the targets; none listed: spread over the camera's own measurement range."""
    reflectivities: Annotated[tuple[Positive, ...], Len(1)] = (0.05, 0.2, 0.5, 0.8)
    """Lambertian reflectivities of the targets."""
    ambient_wpm2: NonNegative = 0.0
    """Irradiance of the targets by ambient light in the camera's band."""
    accuracy: Annotated[float, Interval(gt=0, lt=1)] = 0.03
    """Largest root mean square error of the range, as a part of the range (3 %: König 2008, 4.2.3.3)."""
    valid: Fraction = 0.95
    """Smallest part of the pixels that must be valid."""
    clean: bool = False
    """Judge the ranges after the cleaning that the configuration asks for (without floor and area of interest)."""
    frames: Annotated[int, Ge(8)] = 40
    """Simulated images of each target."""
    side: Annotated[int, Interval(ge=2, le=64)] = 8
    """The centre of the image is simulated by so many times so many pixels on the optical axis."""
    confidence: Annotated[float, Interval(gt=0, lt=1)] = 0.95
    """Of every interval that is given."""
    wavelength_m: Positive = 905e-9
    """Of the light source, for eye safety."""
    source_m: NonNegative = 0.0
    """Size of the apparent source, for eye safety; 0: a point, the strictest case. *open* in the thesis."""
