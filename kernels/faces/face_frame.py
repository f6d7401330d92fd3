"""Faces in one frame: the same place, size and rotation, and one oval.

The frame is tied to the eyes, which stand level and `eyes_px` apart; every other length is a part of that distance.
The oval lies within the outline of a usual face, from the hairline to the chin and between the ears: 1.0 eye
distances to the sides and 1.45 up and down, about a centre 0.35 below the eyes.

Where nobody gives the eyes, `find_face` lays a template head over the normals: the similarity under which slopes of
both agree best, first by correlation over sizes and places, then by least squares. Normals do not depend on skin
or light, so one template does for all. It finds place and size of the face as a whole; where on it the eyes are,
the flow from the template's face to this one says (`face_flow.py`).
"""

from typing import NamedTuple

import cv2
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError
from lightstage.kernels.pictures.nearest_fill import nearest_fill

Array = NDArray[np.float64]
Image = NDArray[np.float32]
_WIDE, _HIGH = 2.8, 3.8
_CENTRE, _HALF_WIDE, _HALF_HIGH = 0.35, 1.0, 1.45
_EDGE = 0.15
"""Width of the oval's soft edge; all are parts of the eye distance."""
_SEARCH_PX = 160
"""The shorter side of the picture in which a face is looked for."""
_SCALES = np.geomspace(0.35, 1.4, 19)
_STEPS = np.array([0.01, 0.01, 0.5, 0.5])
"""Scale, turn and shift (pixels) by which derivatives are taken; resampling is exact to 1/32 pixel."""
_FOUND = 0.81
"""Correlation of slopes below this is no face: heads have 0.87 and more, a sphere 0.75, a cylinder 0.73."""


class Frame(NamedTuple):
    """The frame that all pictures of a set share."""

    eyes_px: float

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns), even."""
        return 2 * round(_HIGH * self.eyes_px / 2), 2 * round(_WIDE * self.eyes_px / 2)

    @property
    def eyes(self) -> Array:
        """(eye, xy): where the left and the right eye of the picture stand."""
        rows, columns = self.shape
        x, y = (columns - 1) / 2, (rows - 1) / 2 - _CENTRE * self.eyes_px
        return np.array([[x - self.eyes_px / 2, y], [x + self.eyes_px / 2, y]])

    def oval(self) -> Image:
        """(y, x) how much of the face is shown: 1 inside, 0 outside, a raised cosine between."""
        rows, columns = self.shape
        y, x = np.mgrid[:rows, :columns]
        y, x = (y - (rows - 1) / 2) / self.eyes_px, (x - (columns - 1) / 2) / self.eyes_px
        radius = np.hypot(x / _HALF_WIDE, y / _HALF_HIGH)
        length = np.hypot(x, y)
        inside = np.where(radius > 0, length * (1 / np.maximum(radius, 1e-9) - 1), _HALF_WIDE)
        return np.asarray((1 - np.cos(np.pi * np.clip(inside / _EDGE, 0, 1))) / 2, np.float32)


def similarity(eyes: Array, frame: Frame) -> Array:
    """(2, 3): frame pixel (x, y, 1) -> picture pixel, by the two eyes (eye, xy) of a picture."""
    (a, b), (p, q) = frame.eyes, np.asarray(eyes, float)
    # as complex numbers a similarity is one multiplication and one shift
    turn = complex(*(q - p)) / complex(*(b - a))
    shift = complex(*p) - turn * complex(*a)
    return np.array([[turn.real, -turn.imag, shift.real], [turn.imag, turn.real, shift.imag]])


def bring(picture: Image, matrix: Array, shape: tuple[int, int]) -> tuple[Image, NDArray[np.bool_]]:
    """A picture resampled to the frame.

    Args:
        picture: (channel, y, x), NaN where not valid.
        matrix: (2, 3), frame pixel -> picture pixel.
        shape: (rows, columns) of the frame.

    Returns:
        (channel, y, x), what is not valid filled from the nearest valid pixel; (y, x) where it is valid.

    Raises:
        KernelError: nothing is valid.
    """
    known = np.isfinite(picture).all(axis=0)
    whole = filled(picture)
    shrink = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
    if shrink > 1:  # what the smaller picture cannot hold would fold into it
        whole = np.stack([cv2.GaussianBlur(c, (0, 0), 0.5 * np.sqrt(shrink**2 - 1) + 1e-3) for c in whole])
    size, back = shape[::-1], cv2.WARP_INVERSE_MAP
    cubic = {"flags": cv2.INTER_CUBIC | back, "borderMode": cv2.BORDER_REPLICATE}
    out = np.stack([cv2.warpAffine(np.ascontiguousarray(c), matrix, size, **cubic) for c in whole])
    there = cv2.warpAffine(known.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR | back, borderValue=0.0)
    return out.astype(np.float32), there > 0.5


def filled(picture: Image) -> Image:
    """A picture (channel, y, x) whose unknown pixels (NaN in any channel) take the nearest known one's values.

    Raises:
        KernelError: nothing is known.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(picture).all(axis=0))
    if not known.any():
        raise KernelError("the picture holds no valid pixel")
    return nearest_fill(picture, known)


def turned(normal: Image, matrix: Array) -> Image:
    """Normals (xyz, y, x) of a face that the frame has turned upright, turned with it."""
    angle = np.arctan2(matrix[1, 0], matrix[0, 0])
    cos, sin = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    # picture y runs down and world y up
    return np.stack([cos * normal[0] - sin * normal[1], sin * normal[0] + cos * normal[1], normal[2]])


def find_face(normal: Image, template: Image) -> tuple[Array, float]:
    """Where a template head lies in a picture.

    Args:
        normal, template: (xyz, y, x) unit vectors, NaN or 0 where there is none. The template holds
            a face and no more.

    Returns:
        (2, 3): template pixel (x, y, 1) -> picture pixel; and the correlation of slopes there, up to 1.

    Raises:
        KernelError: nothing in the picture looks like the template.
    """
    there = np.isfinite(normal).all(axis=0)
    factor = _SEARCH_PX / min(normal.shape[1:])
    picture = _slopes(normal, factor)
    wanted = _slopes(template, 1.0)
    best = (-1.0, 1.0, 0, 0)
    for scale in _SCALES:
        size = (round(wanted.shape[1] * scale), round(wanted.shape[0] * scale))
        if size[0] >= picture.shape[1] or size[1] >= picture.shape[0] or min(size) < 16:
            continue
        score = cv2.matchTemplate(
            picture, cv2.resize(wanted, size, interpolation=cv2.INTER_AREA), cv2.TM_CCORR_NORMED
        )
        _, top, _, (x, y) = cv2.minMaxLoc(np.nan_to_num(score))
        best = max(best, (top, float(scale), x, y))
    if best[0] <= 0 or not there.any():
        raise KernelError("no face is found in the normals")
    rows, columns = np.mgrid[: wanted.shape[0], : wanted.shape[1]].astype(np.float64)
    centre = np.array([(wanted.shape[1] - 1) / 2, (wanted.shape[0] - 1) / 2])

    _, scale, left, top = best
    start = np.array([scale, 0.0, left + scale * centre[0], top + scale * centre[1]])

    def matrix_of(values: Array) -> Array:
        a, b, x, y = start + _STEPS * (values - 1)
        return np.array([[a, -b, x - a * centre[0] + b * centre[1]], [b, a, y - b * centre[0] - a * centre[1]]])

    def misfit(values: Array) -> Array:
        m = matrix_of(values)
        x = (m[0, 0] * columns + m[0, 1] * rows + m[0, 2]).astype(np.float32)
        y = (m[1, 0] * columns + m[1, 1] * rows + m[1, 2]).astype(np.float32)
        return np.asarray((cv2.remap(picture, x, y, cv2.INTER_LINEAR) - wanted).ravel(), np.float64)

    fit = scipy.optimize.least_squares(misfit, np.ones(4), loss="soft_l1", diff_step=1.0)
    matrix = matrix_of(fit.x)
    off = misfit(fit.x) + wanted.ravel()
    score = float(off @ wanted.ravel() / np.sqrt((off @ off) * float((wanted**2).sum()) + 1e-12))
    if not score > _FOUND:
        raise KernelError(f"no face is found in the normals (fit {score:.2f}, a face has {_FOUND:g} and more)")
    # pixel centres of the search picture are at (x + 1/2) factor - 1/2
    matrix = matrix / factor
    matrix[:, 2] += 0.5 / factor - 0.5
    return matrix, score


def _slopes(normal: Image, factor: float) -> Image:
    """(y, x, 2): the sideways parts of the normals, in which a face shows, smaller by `factor` and smooth."""
    plain = np.moveaxis(np.nan_to_num(normal[:2]), 0, 2)
    size = (round(plain.shape[1] * factor), round(plain.shape[0] * factor))
    small = cv2.resize(plain, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), 1.5), np.float32)
