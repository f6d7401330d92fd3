"""Normals at one picture of a performance, from the tracking frames around it: the equation is in
`stages/upsample.py`, what it is made of in `in_between.py`.

Source: Wilson et al. (2010), ACM TOG 29(2); Dutta (2010) 5.1.1 and 5.2.1.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.motion.flow_warp import Interpolation, unit
from lightstage.kernels.motion.in_between import Side, blend, carry, nearness
from lightstage.kernels.motion.joint_flow import subject_of
from lightstage.kernels.normals import quantised

Image = NDArray[np.float32]
_MINIMAL = 2
"""Gradient pictures between two tracking frames of the minimal sequence, whose printed weights are the wrong way
round; Wilson's has three."""


def upsample(
    normal: Mapping[float, Image],
    albedo: Mapping[float, Image],
    flow: Mapping[float, Image],
    confidence: Mapping[float, Image],
    *,
    between: int | None = None,
    weights: str,
    inverse: str,
    interpolation: Interpolation,
) -> Mapping[str, Any]:
    """Normals at one picture.

    All four hold one or two tracking frames, by the time (s) from the picture to them; a single one at 0 is the
    picture itself.

    Args:
        normal: (band, xyz, y, x) unit vectors, NaN where not valid.
        albedo: (band, y, x): the dark around the subject has no normals, only noise.
        flow: (xy, y, x), pixels, from the tracking frame's grid to the picture.
        confidence: of the flow, (y, x), 0 to 1.
        between: pictures between the two tracking frames, for the weights that the thesis prints.
        weights, inverse, interpolation: see UpsampleParams.

    Returns:
        `normal` (xyz, y, x) int16 of unit vectors, bands as one; `confidence` (y, x) float32, 0 to 1.
    """
    if list(normal) == [0]:
        whole = _whole(normal[0], albedo[0])
        known = np.isfinite(whole[0])
        return _result(Side(whole, np.where(known, confidence[0], np.float32(0))))
    sides = [
        carry(
            _whole(normal[away], albedo[away]),
            flow[away],
            confidence[away],
            interpolation=interpolation,
            negated=inverse == "negated",
        )
        for away in normal
    ]
    shares = nearness(0.0, list(normal))
    if weights == "equal":
        shares = np.full(len(sides), 1 / len(sides))
    elif weights == "printed" and between == _MINIMAL:
        shares = shares[::-1]
    return _result(blend(sides, [float(share) for share in shares]))


def _whole(normal: Image, albedo: Image) -> Image:
    """(xyz, y, x): all bands as one, on the subject alone."""
    # NaN in a band is no vote
    whole = unit(np.nansum(normal, axis=0)) if len(normal) > 1 else normal[0]
    return np.where(subject_of(np.nansum(albedo, axis=0)), whole, np.float32(np.nan))


def _result(side: Side) -> Mapping[str, Any]:
    return {
        "normal": quantised.encode(side.normal),
        "confidence": np.asarray(side.confidence, np.float32),
    }
