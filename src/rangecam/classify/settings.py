"""What can be set about classification."""

from typing import Annotated, Literal

from annotated_types import Interval

from rangecam.settings import Fraction, NonNegative, Positive, settings


@settings
class ClassificationSettings:
    """How tracks are classified. Sizes are those of full-size traffic; models need theirs."""

    method: Literal["rules", "learned"] = "rules"
    """rules: limits of size and speed (the thesis); learned: trees that were trained on simulated drives."""
    vru_width_m: tuple[Positive, Positive] = (0.3, 1.0)
    """Rules: least and greatest width of a pedestrian or cyclist."""
    vru_height_m: tuple[Positive, Positive] = (0.8, 2.1)
    vehicle_width_m: tuple[Positive, Positive] = (1.4, 2.6)
    """Rules: least and greatest width of a car or truck."""
    vehicle_height_m: tuple[Positive, Positive] = (0.8, 4.0)
    size_tolerance: Positive = 0.25
    """Rules: how far a size may lie outside its limits, as a share of the nearer limit, before it speaks against the
    class."""
    moving_mps: NonNegative = 0.3
    """Speed over ground from which an object moves; where nobody measures the own speed, which then hides that along
    x, lateral speed. Also for actions."""
    standing_weight: Fraction = 0.2
    """Rules: weight of `vru` for an object of its size that stands: it may as well be a tree or a pole."""
    obstacle_weight: Fraction = 0.5
    """Rules: weight of `obstacle` for an object of any size that stands."""
    unknown_weight: Positive = 0.2
    """Rules: weight of `unknown`, always."""
    memory: Fraction = 0.8
    """Rules: share of the earlier class probabilities in the new ones."""
    model: str = ""
    """Learned: file of a model (`rangecam train`); empty: the one that ships."""
    unknown_below: Annotated[float, Interval(ge=0, lt=1)] = 0.5
    """Learned: a track is `unknown` if no class is more probable than this, ..."""
    unresolved_below: Annotated[float, Interval(ge=0, lt=1)] = 0.85
    """... or than this, where the image does not resolve it: it is cut short beside or hidden in three quarters of the
    last second, or has fewer than 4 by 4 pixels."""
