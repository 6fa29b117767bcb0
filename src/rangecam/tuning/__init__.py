"""Find the noise of the tracker by the likelihood of its innovations (Bar-Shalom, Li and Kirubarajan 2001, 5.4).

A source is followed once, with its settings as they are. What its confirmed tracks took is kept, so that association
is settled; only the filter runs again for each value that is tried. A value is good if it predicts the next measurement
well and says truly how well: too little noise makes the innovations too unlikely, too much makes every one unlikely.

- paths: what the tracks took, and how likely it is
- names: numbers of the settings by name
- search: the most likely values
"""

from rangecam.tuning.names import process_noise, value_of, with_values
from rangecam.tuning.paths import Likelihood, Paths, follow, likelihood, paths_of, side_by_side
from rangecam.tuning.search import Tuned, follow_all, toml_of, tune
from rangecam.workers import mapping, workers

__all__ = [
    "Likelihood",
    "Paths",
    "Tuned",
    "follow",
    "follow_all",
    "likelihood",
    "mapping",
    "paths_of",
    "process_noise",
    "side_by_side",
    "toml_of",
    "tune",
    "value_of",
    "with_values",
    "workers",
]
