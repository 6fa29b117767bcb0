"""How good tracks are, where the truth is known; nothing in the chain uses it.

- consistency: is the covariance honest (NEES, NIS), how large are the errors (RMSE, AMSE)
- scores: GOSPA, CLEAR MOT and HOTA, from the distances between what was there and what was reported
- quality: a run of the chain against the truth of its simulation
"""

from rangecam.metrics.consistency import amse, chi_square_bounds, nees, rmse
from rangecam.metrics.quality import honesty, quality, quality_of, scored
from rangecam.metrics.scores import Clear, Gospa, Hota, Moment, clear_mot, gospa, hota, moment

__all__ = [
    "Clear",
    "Gospa",
    "Hota",
    "Moment",
    "amse",
    "chi_square_bounds",
    "clear_mot",
    "gospa",
    "honesty",
    "hota",
    "moment",
    "nees",
    "quality",
    "quality_of",
    "rmse",
    "scored",
]
