"""What a study is: claims of a thesis beside what this program computes, and the series of a figure."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from decimal import Decimal
from typing import Any

from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Claim:
    """One statement of a thesis and what became of it.

    thesis: the printed number, None where there is none. agrees: None where the thesis has neither number nor statement
    to compare with. why: the tolerance, or what the difference comes from.
    """

    id: str
    text: str
    thesis: float | None
    computed: float
    unit: str
    agrees: bool | None
    why: str


@dataclass(frozen=True, eq=False)
class Series:
    """Points of a figure, (N,) each; with `sigma`, the standard deviation of y, they are drawn with error bars.

    An empty label is left out of the legend. colour: a number, the place among the series if None.
    """

    label: str
    x: ArrayLike
    y: ArrayLike
    sigma: ArrayLike | None = None
    line: str = "-"
    colour: int | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """Values of pixels (H, W), NaN left blank; label: what the colours mean, with unit; limits: of the colours."""

    values: ArrayLike
    label: str
    limits: tuple[float, float]


@dataclass(frozen=True)
class Panel:
    """One pair of axes, labelled with units; with a picture, series lie over it in columns and rows."""

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    log: str = ""
    """Axes that are logarithmic: "", "x", "y" or "xy"."""
    picture: Picture | None = None


@dataclass(frozen=True)
class Study:
    """An experiment: its claims and the panels of its figure. section: where the thesis describes it."""

    name: str
    section: str
    claims: Sequence[Claim]
    panels: Sequence[Panel] = field(default=())


def printed(id: str, text: str, thesis: str, computed: float, unit: str, why: str = "") -> Claim:
    """Return a claim about a printed number, which agrees within half a unit of its last digit.

    thesis: the number as it is printed. why: what a difference comes from.
    """
    digits = Decimal(thesis)
    exponent = digits.as_tuple().exponent
    assert isinstance(exponent, int)
    agrees = abs(Decimal(float(computed)) - digits) <= Decimal(1).scaleb(exponent) / 2
    reason = "within half a unit of the last printed digit" if agrees else why
    return Claim(id, text, float(digits), float(computed), unit, bool(agrees), reason)


def judged(id: str, text: str, thesis: float | None, computed: float, unit: str, agrees: bool, why: str) -> Claim:
    """Return a claim whose agreement is judged by another rule, which `why` states."""
    return Claim(id, text, None if thesis is None else float(thesis), float(computed), unit, bool(agrees), why)


def derived(id: str, text: str, computed: float, unit: str, why: str = "the thesis prints no number") -> Claim:
    """Return a number that follows from the thesis' settings, without one of the thesis to compare with."""
    return Claim(id, text, None, float(computed), unit, None, why)


def as_json(studies: Sequence[Study]) -> dict[str, Any]:
    """Return the studies as plain values for JSON."""
    return {
        "studies": [
            {"name": study.name, "section": study.section, "claims": [asdict(claim) for claim in study.claims]}
            for study in studies
        ]
    }


def table(study: Study) -> str:
    """Return the claims of a study as lines for people."""
    lines = [f"{study.name}: {study.section}", f"{'':13} {'thesis':>10} {'computed':>10}"]
    for claim in study.claims:
        verdict = {True: "agrees", False: "DIFFERS", None: ""}[claim.agrees]
        thesis = "-" if claim.thesis is None else f"{claim.thesis:.5g}"
        lines.append(
            f"{claim.id:13} {thesis:>10} {claim.computed:10.5g} {claim.unit:8} {verdict:8} {claim.text} ({claim.why})"
        )
    return "\n".join(lines)


def verdicts(studies: Sequence[Study]) -> str:
    """Return how many claims of each study agree, differ, or have no printed number: a line each, and the sum."""
    rows = [(study.name, [claim.agrees for claim in study.claims]) for study in studies]
    rows.append(("all", [agrees for _, column in rows for agrees in column]))
    lines = [f"{'':20} {'claims':>7} {'agree':>7} {'differ':>7} {'derived':>8}"]
    for name, column in rows:
        agree, differ = column.count(True), column.count(False)
        lines.append(f"{name:20} {len(column):7} {agree:7} {differ:7} {column.count(None):8}")
    return "\n".join(lines)
