"""The planes of a raw frame, checked before a kernel reads them."""

from collections.abc import Sequence

import numpy as np

from rangecam.errors import DataError
from rangecam.types import Image, RawFrame


def plane_of(raw: RawFrame, name: str, needed: Sequence[str]) -> Image:
    """Return the plane `name` (H, W) of a frame, of any real number type.

    needed: the planes that the method cannot do without; the first gives the shape that all must have.
    Raises DataError if the plane is missing, has another shape or does not hold real numbers.
    """
    if name not in raw.planes:
        wanted = needed if len(needed) <= 8 else (*needed[:2], "...", *needed[-2:])
        raise DataError(
            f"frame {raw.frame_id}: plane '{name}' is missing; this method needs {', '.join(wanted)}, "
            f"the frame has {', '.join(sorted(raw.planes)) or 'none'}"
        )
    plane, shape = np.asarray(raw.planes[name]), np.asarray(raw.planes[needed[0]]).shape
    if plane.ndim != 2 or plane.shape != shape:
        raise DataError(
            f"frame {raw.frame_id}: plane '{name}' has shape {plane.shape}; it must be an image (rows, columns) "
            f"of the shape of '{needed[0]}', {shape}"
        )
    if plane.dtype.kind not in "uif":
        raise DataError(f"frame {raw.frame_id}: plane '{name}' holds {plane.dtype}; it must hold real numbers")
    return plane
