"""What a camera records without light: the kernel of `stages/calibration/dark.py`.

Means and hot pixels are in `defects.py`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.targets.defects import find_hot, moments
from lightstage.kernels.targets.item_pictures import SCALE, listed, stored
from lightstage.kernels.targets.verdicts import Verdict

_BRIGHTEST = 0.25
"""Of the range: a dark with a higher median shows light."""


def dark(raw: Mapping[tuple[int, float], NDArray[np.uint16]], *, white_level: int) -> Mapping[str, Any]:
    """Mean, noise and hot pixels of one camera.

    Args:
        raw: (y, x) by frame and band, counts.
        white_level: the count at which the sensor saturates.

    Returns:
        `mean` (y, x) and `noise` (y, x) in counts, `hot` (y, x), `threshold` () in counts.

    Raises:
        KernelError: the frames are not dark.
    """
    frames = moments(raw.values(), white_level=white_level)
    level = float(np.median(frames.mean))
    if level > _BRIGHTEST * white_level:
        raise KernelError(
            f"the dark frames have {level:.0f} of {white_level} counts: they show light; cover the lens"
        )
    hot, threshold = find_hot(frames.mean, white_level=white_level)
    return {
        "mean": frames.mean.astype(np.float32),
        "noise": np.sqrt(frames.variance).astype(np.float32),
        "hot": hot,
        "threshold": np.array(threshold),
    }


def item(
    *, arrays: Mapping[str, Any], labels: Mapping[str, Any], attrs: Mapping[str, Any], facts: Mapping[str, Any]
) -> Mapping[str, Any]:
    """The dark item."""
    names = [facts["cameras"][polarisation] for polarisation in labels["polarisation"]]
    content: dict[str, Any] = {
        "item": "dark",
        "images": {name: stored(mean) for name, mean in zip(names, arrays["mean"], strict=True)},
        "scale": SCALE,
        "hot_px": {name: listed(hot) for name, hot in zip(names, arrays["hot"], strict=True)},
    }
    if "exposure_s" in attrs:
        content["exposure_s"] = attrs["exposure_s"]
    return content


def verdict(
    *, arrays: Mapping[str, Any], labels: Mapping[str, Any], attrs: Mapping[str, Any], facts: Mapping[str, Any]
) -> Verdict:
    """Level, noise and hot pixels of each camera."""
    findings: Verdict = []
    for i, polarisation in enumerate(labels["polarisation"]):
        noise = arrays["noise"][i]
        sentence = (
            f"{facts['cameras'][polarisation]}: "
            f"dark {float(np.median(arrays['mean'][i])):.2f} counts, "
            + (f"noise {float(np.sqrt(np.mean(noise**2))):.2f} counts, " if np.isfinite(noise).all() else "")
            + f"{int(arrays['hot'][i].sum())} hot pixels "
            f"(more than {float(arrays['threshold'][i]):.1f} counts above others), "
            f"from {attrs['frames']} frames"
        )
        findings.append(("good", sentence))
    return findings
