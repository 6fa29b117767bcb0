"""The picture of a camera before it is built: accuracy over range and reflectivity, limits, and what sets them.

For every family, by its one simulated camera and its one chain.
- settings: the plan of the experiment; families: what each family must tell
- experiment: targets before pixels, with intervals of `statistics`; limits: from where to where, and why
- facts: numbers without simulation; analysis: all of it; figures, page: shown
"""

from rangecam.design.analysis import Design, as_json, judge
from rangecam.design.page import describe, html
from rangecam.design.settings import Plan

__all__ = ["Design", "Plan", "as_json", "describe", "html", "judge"]
