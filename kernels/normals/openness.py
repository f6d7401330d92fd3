"""How much of the lights a point sees, told by how narrow its light is.

A point that sees evenly spread lights within a cone of half angle t about its normal receives

    s = sin^2 t

of what an open point does, and the mean direction of its light, weighted by how much of it arrives, has the length

    d = 2/3 (1 - cos^3 t) / (1 - cos^2 t) ,

2/3 for an open point and 1 behind a pinhole. Gradients measure that length, |m| / r_c, at every pixel and whatever
the albedo. So where the measured length is not the one that the found surface explains, what hides the lights is
other than the found surface, most often finer: creases, eyelids, the wings of a nose. The difference of the two
moves d, and d tells s.

Only the difference counts, so it matters little that real lights are few, near and not all around.

Limits: light that other points of a crease pass on makes d smaller again; it must have been taken out. What hides
the lights on one side only is no cone. A point that is open to all lights cannot become more open.

Sources: Landis (2002), SIGGRAPH course notes, for the mean unoccluded direction; Oat and Sander (2007),
doi:10.1145/1230100.1230111, and Klehm et al. (2011) for cones in its place. To measure it is ours.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_COS = np.linspace(0.0, 0.999, 2000)
_SHARE = 1 - _COS**2
_LENGTH = 2 / 3 * (1 - _COS**3) / (1 - _COS**2)


def share_of_light(share: Array, excess: Array) -> Array:
    """The share of its light that a point receives, corrected by the length of its mean direction.

    Args:
        share: what the found surface lets arrive, relative to an open point, 0 to 1; any shape.
        excess: by how much |m| / r_c is larger than the found surface explains; of that shape.

    Returns:
        the share, above 0 and up to 1.
    """
    length = np.interp(np.clip(share, _SHARE[-1], 1), _SHARE[::-1], _LENGTH[::-1])
    return np.asarray(np.interp(length + excess, _LENGTH, _SHARE), np.float64)
