"""Diffuse and specular components from two polarisations: the equations are in `stages/split.py`.

Source: Ma et al. (2007) section 3; Dutta (2010) 3.2.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def split(signal: NDArray[np.float32], *, polarisations: Sequence[str]) -> Mapping[str, Any]:
    """Split one frame and band.

    Args:
        signal: (polarisation, y, x), registered counts; NaN where not valid.
        polarisations: what lies along the first axis.

    Returns:
        `signal` (component, y, x) float32: diffuse and specular, or diffuse, or total, as `components` says;
        NaN where a camera that is needed has no valid value. With a specular component, `stats` holds
        `negative_specular_fraction`.
    """
    if "cross" not in polarisations:
        return {"signal": signal}
    cross = signal[polarisations.index("cross")]
    if "parallel" not in polarisations:
        return {"signal": 2 * cross[None]}
    out = np.empty((2, *cross.shape), np.float32)
    np.multiply(cross, 2, out=out[0])
    np.subtract(signal[polarisations.index("parallel")], cross, out=out[1])
    return {
        "signal": out,
        "stats": {"negative_specular_fraction": np.count_nonzero(out[1] < 0) / out[1].size},
    }
