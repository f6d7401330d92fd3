"""Pictures that do not belong to the set that they are in: dropped, repeated, mislabelled, black, another scene.

Each function marks the members that it leaves out, takes confidence from places of the others, and gives a sentence
for each that it leaves out. Residuals are no measure: wrong flows can have smaller ones than the true flow.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lightstage.kernels.motion import joint_flow
from lightstage.kernels.motion.shots import DOUBTED, Image, Member
from lightstage.kernels.pictures import blurs
from lightstage.kernels.pictures.picture_sets import pairs

_MISFIT = 0.15
"""Relative violation of the complement constraint, over a few pixels, that halves confidence. A head that turns by
some degrees within a window stays below it; a hand, or another picture, does not."""
_TEXTURED = 0.5
"""Correlation of fine texture with the tracking frame from which it says something."""
_BLACK = 0.04
"""Of the tracking frame's mean: a gradient picture has a sixth of it at least, from where a face looks."""
_CONSTANT = 0.93
"""Of the tracking frame: a gradient picture has five sixths at most."""
_TYPICAL_WIDTH_PX = 406
"""Of the pictures in which the widths of neighbourhoods were set."""
_LOCAL_PX = 3.0
"""Sigma of a neighbourhood, in pictures of that width or less."""


def leave_out_misplaced(constant: Member, others: Sequence[Member]) -> list[str]:
    """Members that cannot be what they are called, before any alignment."""
    if not np.isfinite(constant.picture).any():
        _leave_out(constant, *others)
        return [f"{constant} holds no valid pixel (saturated?); its set is left out"]
    subject = joint_flow.subject_of(constant.picture)
    if not subject.any():
        _leave_out(*others)
        return [f"{constant} is black, so nothing can be aligned to it; its set is left out"]
    brightness = {m.place: _brightness(m.picture, constant.picture, subject) for m in others}
    known = [value for value in brightness.values() if np.isfinite(value)]
    if known and np.median(known) > 1 / _CONSTANT:
        _leave_out(constant, *others)
        return [f"{constant} is darker than the gradients around it: no constant light; its set is left out"]
    warnings = []
    earlier = sorted([constant, *others], key=lambda m: m.place)
    for member in others:
        before = [m for m in earlier if m.place < member.place]
        reason = _misplaced(member, brightness[member.place], constant, before)
        if reason is not None:
            _leave_out(member)
            warnings.append(f"{member} {reason}; it is left out (was a picture dropped or repeated?)")
    return warnings


def _misplaced(member: Member, brightness: float, constant: Member, before: Sequence[Member]) -> str | None:
    """Why a member cannot be what it is called."""
    if not np.isfinite(brightness):
        return f"holds no valid pixel where {constant} shows the subject (saturated?)"
    if brightness <= _BLACK:
        return f"is black beside {constant}"
    if not member.is_constant and brightness > _CONSTANT:
        return f"is as bright as {constant}, so it shows constant light"
    if member.is_constant and not same_scene(member.picture, constant.picture):
        return f"shows another scene than {constant}"
    for other in before:
        if np.array_equal(member.picture, other.picture, equal_nan=True):
            return f"repeats {other}: the same picture twice"
    return None


def leave_out_foreign(constant: Member, moved: Mapping[int, Image], members: Sequence[Member]) -> list[str]:
    """Take confidence from where a picture lacks the texture that others of the set share with the tracking frame;
    leave out those that nowhere have it: a hand, another scene.

    Correlation of fine texture is 0.86 and more on the rendered heads, in dim gradients too. It is held against the
    best of the set, so that a subject without texture is not judged.

    Args:
        moved: pictures by place, along their flows. members: theirs.
    """
    subject = joint_flow.subject_of(constant.picture)
    bright = np.float32(np.nanmax(np.where(subject, constant.picture, 0)) or 1.0)
    own = _texture(constant.picture / bright, subject)
    energy = _local(own * own, 2.0)
    whole, local = {}, {}
    for place, picture in moved.items():
        theirs = _texture(picture / bright, subject & np.isfinite(picture))
        known = subject & np.isfinite(picture)
        size = float(np.sqrt(np.sum(own[known] ** 2) * np.sum(theirs[known] ** 2)))
        whole[place] = float(np.sum(own[known] * theirs[known])) / size if size > 0 else 0.0
        both = energy * _local(theirs * theirs, 2.0)
        local[place] = _local(own * theirs, 2.0) / np.sqrt(np.maximum(both, np.float32(1e-20)))
    best = max(whole.values(), default=0.0)
    if best < _TEXTURED:
        return []
    warnings = []
    for member in members:
        if whole[member.place] < best / 2:
            _leave_out(member)
            warnings.append(
                f"{member} does not show what the tracking frame and the others show (texture correlates by "
                f"{whole[member.place]:.2f}, the others' by up to {best:.2f}); it is left out (is something in the "
                "way, or does the scene change?)"
            )
    good = [m for m in members if not m.left_out]
    sharpest = np.max([local[m.place] for m in good], axis=0)
    for member in good:
        lacks = (sharpest > _TEXTURED) & (local[member.place] < sharpest / 3)
        member.confidence = np.where(lacks, np.minimum(member.confidence, DOUBTED), member.confidence)
    return warnings


def leave_out_contradicted(constant: Member, moved: Mapping[int, Image], members: Sequence[Member]) -> list[str]:
    """Take confidence from where a pair does not add up to the tracking frame; leave out pairs that nowhere do.

    Args:
        moved: pictures by place, along their flows. members: theirs.
    """
    warnings = []
    subject = joint_flow.subject_of(constant.picture)
    level = _local(np.where(subject, constant.picture, np.float32(0)))
    for i, j in pairs([m.illumination for m in members]):
        a, b = members[i], members[j]
        off = np.where(subject, moved[a.place] + moved[b.place] - constant.picture, np.float32(0))
        misfit = np.abs(_local(np.nan_to_num(off))) / np.maximum(level, np.float32(1e-6))
        typical = float(np.median(misfit[subject])) if subject.any() else 0.0
        if typical > _MISFIT:
            _leave_out(a, b)
            warnings.append(
                f"{a} and {b} are {100 * typical:.0f} % off their sum, the constant picture; they are left out "
                "(was a picture dropped, repeated or mislabelled, or does the scene change?)"
            )
            continue
        factor = np.float32(1) / (1 + (misfit / np.float32(_MISFIT)) ** 4)
        a.confidence *= factor
        b.confidence *= factor
    return warnings


def same_scene(picture: Image, constant: Image) -> bool:
    """Whether a tracking frame beside this one shows the same subject, a little moved."""
    subject = joint_flow.subject_of(constant) & np.isfinite(picture)
    if not subject.any():
        return False
    a, b = (blurs.gaussian(np.nan_to_num(p), constant.shape[1] / 100) for p in (picture, constant))
    return bool(np.abs(a - b)[subject].mean() < 0.5 * b[subject].mean())


def _leave_out(*members: Member) -> None:
    for member in members:
        member.left_out = True


def _brightness(picture: Image, constant: Image, subject: NDArray[np.bool_]) -> float:
    """Of a picture beside the tracking frame, where both are known; NaN where none is."""
    both = subject & np.isfinite(picture)
    return float(picture[both].mean() / constant[both].mean()) if both.any() else float("nan")


def _texture(picture: Image, lit: NDArray[np.bool_]) -> Image:
    smooth = blurs.gaussian(np.where(np.isfinite(picture), picture, np.float32(0)), 0.8)
    return joint_flow.fine_texture(smooth, lit)


def _local(picture: Image, wide: float = 1.0) -> Image:
    """The mean over a neighbourhood, `wide` times the usual one."""
    return np.asarray(blurs.gaussian(picture, wide * _LOCAL_PX * max(1.0, picture.shape[1] / _TYPICAL_WIDTH_PX)))
