"""How the outline of a segment changes from its top to its bottom: head, shoulders, legs; a bonnet before a cabin."""

from typing import Any

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def outline_profile(labels: Any, points: Any, box: Any, profile: Any) -> None:
    """Write the `profile` of `Segments` (N, 3, B); a kernel. box (N, 4) of each segment.

    Bands have as many rows as fit; of a segment with fewer rows than bands, a row is in several. Distances along the
    ground are taken from their squares, whose mean is that of the distance but for (spread / distance)^2.
    """
    bands = profile.shape[2]
    for k in range(len(box)):
        rows, columns = box[k, 2] - box[k, 0], box[k, 3] - box[k, 1]
        whole, total = 0.0, 0
        for band in range(bands):
            first = band * rows // bands
            last = max((band + 1) * rows // bands, first + 1)
            across, count, squares = 0, 0, 0.0
            for row in range(box[k, 0] + first, box[k, 0] + last):
                low, high = -1, -1
                for column in range(box[k, 1], box[k, 3]):
                    if labels[row, column] == k + 1:
                        low = column if low < 0 else low
                        high = column
                        count += 1
                        x, y = float(points[row, column, 0]), float(points[row, column, 1])
                        squares += x * x + y * y
                across += high - low + 1 if high >= 0 else 0
            whole, total = whole + squares, total + count
            area = (last - first) * columns
            profile[k, 0, band], profile[k, 1, band] = across / area, count / area
            profile[k, 2, band] = squares / count if count > 0 else -1.0
        mean = whole / total
        away = max(mean, 1e-6) ** 0.5
        for band in range(bands):
            square = profile[k, 2, band]
            profile[k, 2, band] = (square - mean) / (2.0 * away) if square >= 0.0 else 0.0
