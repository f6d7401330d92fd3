"""How results are stored in steps, so that they take little space and nothing that was measured is lost."""

from collections.abc import Mapping
from typing import Any

NORMAL_STEPS = 32767
"""Stored normals are int16: component x this. The error is below 0.002 degrees."""
NORMAL_FILL = -32768
"""Stored where there is no normal; reads as NaN."""
NORMAL_ATTRS: Mapping[str, Any] = {
    "scale_factor": 1 / NORMAL_STEPS,
    "_FillValue": NORMAL_FILL,
    "units": "unit vector",
}
"""What an array of stored normals says of itself (CF conventions): xarray reads unit vectors."""
VISIBILITY_STEPS = 255
"""A light that is seen whole, as it is stored."""
EDGE_RIGHT, EDGE_BELOW = 1, 2
"""Bits of `edge`: the surface is broken towards the neighbour to the right, below."""
SIGNAL_STEP = 1 / 256
"""Counts are rounded to this. A pixel's noise is a count and more, so its variance grows by less than 2e-6; the
digits beyond would be random, and cost half as much again to store and to write."""
RADIANCE_BITS = 16
"""Of the mantissa's 23: a relative step of 1.5e-5, as fine at 256 counts as the counts that it is made of (Kloewer
et al. 2021, doi:10.1038/s43588-021-00156-2). Random digits cost half as much again to store."""
