"""Pictures made equal in what an experiment must not vary: mean and contrast, histogram, amplitude spectrum.

Every picture is a face y_i in linear luminance, shown through one oval w before one background b,

    p_i = w y_i + (1 - w) b ,

and what is equal is equal in the *stored* picture: p_i is turned into code values of 8 bits, and mean, contrast and
spectrum are measured on those, decoded to luminance again. What rounding changes is put right in the next round.

    mean-contrast   mean and standard deviation over the oval, of luminance and of code values: each picture gets a
                    monotone curve a + b (z + c sqrt(1 + z^2) + d tanh z) of its standardised luminance z, which has
                    as many free numbers as there are figures to meet
    histogram       each picture gets exactly the values of the set's mean histogram, in the order of its own
                    luminance; equal luminance is ordered by the mean of the neighbourhood, then by place. Oval and
                    soft edge are ordered apart, so that the edge meets the background
    spectrum        the rotational average of the amplitude of the whole picture is the set's, and mean and contrast
                    too: each ring of frequencies has one gain, found in rounds; then small steps on the stored
                    picture, with a bend of the tones that holds the contrast of code values. With histogram, the
                    histograms are equal but for these small steps

The targets are means over the set.

Sources: Willenbockel et al. (2010), doi:10.3758/BRM.42.3.671 (the SHINE toolbox: lumMatch, histMatch, sfMatch);
Coltuc, Bolon, Chassery (2006), doi:10.1109/TIP.2005.864170, for exact histograms.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from lightstage.kernels.errors import KernelError

Array = NDArray[np.float64]
Codes = NDArray[np.uint8]
TOP = 255
METHODS = ("mean-contrast", "histogram", "spectrum")
ENOUGH_LEVELS, ENOUGH_SPECTRUM = 0.25, 0.006
"""Rounds end when means and contrasts are this near to the set's (grey levels), and rings (part)."""
PROMISED_LEVELS, PROMISED_SPECTRUM = 0.5, 0.01
"""What is promised of any two pictures, and of rings."""
_ROUNDS, _SMALL_ROUNDS = 12, 120
_LEVEL_ROUNDS = 4
_STEP, _SMALL_STEP = 0.8, 0.5
_SMALL_LIGHT = 1e-3
_RIM = 8.0
_WEIGHTS = np.array([8.0, 8.0, 1.0, 1.0])
_EDGE_CLASSES = 4
_LEAST_RING = 1


class Encoding(NamedTuple):
    """How luminance 0..1 becomes code values 0..1, and back."""

    encode: Callable[[Array], Array]
    decode: Callable[[Array], Array]

    def code(self, luminance: Array) -> Array:
        """Code values 0..255, not rounded; luminance outside 0..1 is clipped."""
        return TOP * np.asarray(self.encode(np.clip(luminance, 0, 1)))

    def luminance(self, codes: NDArray[Any]) -> Array:
        """Luminance of code values 0..255."""
        return np.asarray(self.decode(np.asarray(codes, np.float64) / TOP))


class Figures(NamedTuple):
    """What a stored picture measures over the oval; all in grey levels of 0..255."""

    mean_linear: float
    contrast_linear: float
    """Standard deviation of luminance."""
    mean_code: float
    contrast_code: float
    """Standard deviation of code values."""

    @property
    def rms(self) -> float:
        """RMS contrast: standard deviation of luminance over its mean."""
        return self.contrast_linear / self.mean_linear if self.mean_linear > 0 else float("nan")


@dataclass(frozen=True)
class Matched:
    """One picture of a matched set."""

    luminance: Array
    """(y, x) linear, before rounding; the whole picture with its background."""
    figures: Figures
    """Of the picture as it is stored."""
    spectrum: Array
    """(ring,) mean amplitude of luminance, as it is stored."""
    clipped: float
    """Part of the oval that did not fit between black and white."""


class Setting(NamedTuple):
    """What all pictures of a set share."""

    oval: Array
    background: float
    encoding: Encoding
    store: Callable[[int, Array], Codes]
    """(index, luminance (y, x)) -> the code values that are stored, (y, x) or (y, x, rgb)."""
    seen: Callable[[Codes], Array]
    """Luminance (y, x) of stored code values."""
    channels: Callable[[int, Array], Array]
    """(index, luminance (y, x)) -> linear light of what is stored, (y, x) or (y, x, rgb); 0 to 1 fits."""


def grey_setting(oval: Array, background: float, encoding: Encoding) -> Setting:
    """A set of grey pictures."""
    return Setting(
        oval,
        background,
        encoding,
        lambda _, luminance: np.floor(encoding.code(luminance) + 0.5).astype(np.uint8),
        lambda codes: encoding.luminance(codes),
        lambda _, luminance: luminance,
    )


def figures(codes: Codes, setting: Setting) -> Figures:
    """Measure a stored picture over the oval with its soft edge."""
    inside = setting.oval > 0
    luminance = setting.seen(codes)[inside]
    code = codes[inside].astype(np.float64) if codes.ndim == 2 else setting.encoding.code(luminance)
    return Figures(TOP * luminance.mean(), TOP * luminance.std(), float(code.mean()), float(code.std()))


def rings(shape: tuple[int, int]) -> NDArray[np.int64]:
    """(y, x) ring of each frequency of a DFT: cycles over the shorter side, rounded, at most its Nyquist limit."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :]
    short = min(shape)
    return np.asarray(np.minimum(np.rint(np.hypot(fy, fx) * short), short // 2), np.int64)


def spectrum(luminance: Array) -> Array:
    """(ring,) mean amplitude of the frequencies of each ring; ring 0 is the mean's, and not counted by anyone."""
    ring = rings(luminance.shape)
    amplitude = np.abs(np.fft.fft2(luminance)) / luminance.size
    return np.asarray(np.bincount(ring.ravel(), amplitude.ravel()) / np.bincount(ring.ravel()))


def match(
    faces: Sequence[Array],
    setting: Setting,
    methods: Sequence[str],
    *,
    mean: float | None = None,
    contrast: float | None = None,
) -> list[Matched]:
    """Make a set equal.

    Args:
        faces: (y, x) linear luminance of each face over the whole frame, about 0 to 1.
        setting: what the set shares; its background may be NaN: the mean of the set.
        methods: of METHODS; none: only shown through the oval. histogram contains mean-contrast.
        mean, contrast: luminance to meet, 0 to 1, instead of the set's own.

    Raises:
        KernelError: a method is not known, or a face has no contrast.
    """
    wrong = [name for name in methods if name not in METHODS]
    if wrong:
        raise KernelError(f"'{wrong[0]}' is no way of matching; there are {', '.join(METHODS)}")
    inside = setting.oval > 0
    own = np.array([(face[inside].mean(), face[inside].std()) for face in faces])
    if (own[:, 1] < 1e-6).any():
        raise KernelError("a picture has no contrast within the oval, so it cannot be matched")
    usual = own.mean(axis=0)
    wanted = (usual[0] if mean is None else mean, usual[1] if contrast is None else contrast)
    if np.isnan(setting.background):
        setting = setting._replace(background=float(wanted[0]))
    if not methods:
        return [_measured(i, _shown(face, setting.oval, setting), setting) for i, face in enumerate(faces)]
    fields = _levelled(faces, own, wanted, setting, asked=(mean, contrast))
    levels: Sequence[_Level]
    if "histogram" in methods:
        common = _Histogram(fields, setting)
        levels = [common] * len(fields)
    else:
        target = np.mean([_figures(_shown(f, setting.oval, setting)[inside], setting) for f in fields], axis=0)
        levels = [_Curve(target, setting) for _ in fields]
    first = [_repeated(level, i, field) for i, (level, field) in enumerate(zip(levels, fields, strict=True))]
    if "spectrum" not in methods:
        return first
    spectra = np.mean([face.spectrum for face in first], axis=0)
    return [
        _with_spectrum(i, _shown(field, setting.oval, setting), spectra, setting, level)
        for i, (level, field) in enumerate(zip(levels, fields, strict=True))
    ]


def _levelled(
    faces: Sequence[Array],
    own: Array,
    wanted: tuple[float, float],
    setting: Setting,
    *,
    asked: tuple[float | None, float | None],
) -> list[Array]:
    """Faces on one level before they meet the background, or their edges would be other than its colour.

    The soft edge takes some contrast; what somebody asked for holds with the edge, so faces get a little more.
    """
    inside = setting.oval > 0
    middle, spread = wanted
    for _ in range(_LEVEL_ROUNDS):
        fields = [middle + (f - m) * spread / s for f, (m, s) in zip(faces, own, strict=True)]
        shown = [_shown(field, setting.oval, setting)[inside] for field in fields]
        if asked[0] is not None:
            middle += asked[0] - float(np.mean([values.mean() for values in shown]))
        if asked[1] is not None:
            spread *= asked[1] / float(np.mean([values.std() for values in shown]))
    return fields


def _shown(face: Array, fade: Array, setting: Setting) -> Array:
    """A face before the background."""
    return np.asarray(fade * face + (1 - fade) * setting.background)


def _figures(luminance: Array, setting: Setting) -> Array:
    code = setting.encoding.code(luminance)
    return np.array([TOP * luminance.mean(), TOP * luminance.std(), code.mean(), code.std()])


def _measured(index: int, picture: Array, setting: Setting) -> Matched:
    inside = setting.oval > 0
    codes = setting.store(index, picture)
    light = setting.channels(index, picture)[inside]
    outside = ((light < -0.5 / TOP) | (light > 1 + 0.5 / TOP)).reshape(len(light), -1).any(axis=1)
    return Matched(picture, figures(codes, setting), spectrum(setting.seen(codes)), float(outside.mean()))


class _Level(ABC):
    """What brings one picture's luminance to the set's."""

    def __init__(self, target: Array, setting: Setting) -> None:
        self.target, self.setting = target, setting

    @abstractmethod
    def __call__(self, index: int, field: Array, fade: Array) -> Matched:
        """A face (y, x) before the background, `fade` how much of it is shown."""

    def off(self, candidate: Matched) -> float:
        """How far the picture still is from the set's figures, grey levels."""
        return float(np.abs(np.array(candidate.figures) - self.target).max())


def _repeated(level: _Level, index: int, field: Array) -> Matched:
    """The nearest of a few rounds: each puts right what rounding to code values did in the one before."""
    best = level(index, field, level.setting.oval)
    for _ in range(_LEVEL_ROUNDS):
        if level.off(best) < ENOUGH_LEVELS:
            break
        candidate = level(index, field, level.setting.oval)
        best = min(best, candidate, key=level.off)
    return best


class _Curve(_Level):
    """Mean and standard deviation, of luminance and code values: a monotone curve, corrected call by call."""

    def __init__(self, target: Array, setting: Setting) -> None:
        super().__init__(target, setting)
        self._aim = target.copy()
        self._start = np.array([target[0] / TOP, target[1] / TOP, 0.0, 0.0])
        self._settled = False

    def __call__(self, index: int, field: Array, fade: Array) -> Matched:
        inside = self.setting.oval > 0
        values, part = field[inside], fade[inside]
        standard = (values - values.mean()) / values.std()
        out = np.full(field.shape, self.setting.background)
        out[inside] = self._curve(standard, part)
        candidate = _measured(index, out, self.setting)
        off = np.array(candidate.figures) - self.target
        self._settled = float(np.abs(off).max()) < ENOUGH_LEVELS / 2
        if not self._settled:
            self._aim -= np.clip(off, -5, 5)
        return candidate

    def _curve(self, standard: Array, part: Array) -> Array:
        """Values that meet the four figures best; luminance counts before code values."""
        ends = np.linspace(standard.min(), standard.max(), 33)
        bent, soft = np.sqrt(1 + standard**2), np.tanh(standard)
        slopes = ends / np.sqrt(1 + ends**2), 1 / np.cosh(ends) ** 2
        rest = (1 - part) * self.setting.background

        def values(p: Array) -> Array:
            curve = p[0] + p[1] * (standard + p[2] * bent + p[3] * soft)
            return np.asarray(part * curve + rest)

        def misfit(p: Array) -> Array:
            # a curve that turns back would exchange light and dark
            back = np.minimum(1 + p[2] * slopes[0] + p[3] * slopes[1] - 0.1, 0)
            return np.concatenate([_WEIGHTS * (_figures(values(p), self.setting) - self._aim), 50 * back])

        if self._settled:  # a curve that stays lets the rounds of the spectrum settle too
            return values(self._start)
        scale = [0.01, 0.01, 0.1, 0.1]
        fit = scipy.optimize.least_squares(misfit, self._start, x_scale=scale, max_nfev=20, ftol=1e-6)
        self._start = fit.x
        return values(fit.x)


class _Histogram(_Level):
    """Exactly one multiset of luminance values for all, the mean of the sorted ones, in each part of the oval."""

    def __init__(self, fields: Sequence[Array], setting: Setting) -> None:
        part = np.where(setting.oval >= 1, _EDGE_CLASSES, np.floor(setting.oval * _EDGE_CLASSES)).astype(int)
        shown = [_shown(field, setting.oval, setting).ravel() for field in fields]
        self._parts = [np.flatnonzero((part == k) & (setting.oval > 0)) for k in range(_EDGE_CLASSES + 1)]
        self._common = [np.mean([np.sort(p[at]) for p in shown], axis=0) for at in self._parts]
        super().__init__(_figures(np.concatenate(self._common), setting), setting)

    def __call__(self, index: int, field: Array, fade: Array) -> Matched:
        picture = _shown(field, fade, self.setting)
        near = cv2.boxFilter(picture, -1, (3, 3)).ravel()
        far = cv2.boxFilter(picture, -1, (5, 5)).ravel()
        flat = picture.ravel()
        out = np.full(flat.shape, self.setting.background)
        for at, values in zip(self._parts, self._common, strict=True):
            # lexsort's last key counts first; places order what is equal in all
            out[at[np.lexsort((at, far[at], near[at], flat[at]))]] = values
        return _measured(index, out.reshape(picture.shape), self.setting)


def _with_spectrum(index: int, picture: Array, target: Array, setting: Setting, level: _Level) -> Matched:
    """First gains of the rings, with the picture levelled after each round; then small steps on what came out.

    The gains bring all but the last percents. What is left is rounding, which a new level would throw anew, so the
    second part only adds what lacks, a part of a grey level, and few pixels change their code value.
    """
    ring = rings(picture.shape)
    rest = np.fft.fft2(picture - setting.background)
    gain = np.ones(target.size)
    fade = np.clip(_RIM * setting.oval, 0, 1)
    best = float("inf"), level(index, picture, fade)
    for _ in range(_ROUNDS):
        candidate = level(index, np.real(np.fft.ifft2(rest * gain[ring])) + setting.background, fade)
        best = min(best, (_worst(candidate, target, level), candidate), key=lambda pair: pair[0])
        gain[_LEAST_RING:] *= _lacking(candidate, target, _STEP)
    for k in range(_SMALL_ROUNDS):
        worst, candidate = best if k == 0 else (_worst(candidate, target, level), candidate)
        best = min(best, (worst, candidate), key=lambda pair: pair[0])
        if worst < 1:
            break
        gain = np.concatenate([[0.0], _lacking(candidate, target, _SMALL_STEP)])
        now = np.fft.fft2(setting.seen(setting.store(index, candidate.luminance)) - setting.background)
        amplitude = np.abs(now)
        # equal rings leave the contrast open: it grows when the strong frequencies of a ring grow and the weak fall
        uneven = (amplitude / np.maximum(candidate.spectrum[ring] * now.size, 1e-12)) ** _spread(candidate, level)
        uneven /= (
            np.bincount(ring.ravel(), (amplitude * uneven).ravel()) / np.bincount(ring.ravel(), amplitude.ravel())
        )[ring]
        more = (level.target[0] - candidate.figures.mean_linear) / TOP + np.real(
            np.fft.ifft2(now * np.where(ring < _LEAST_RING, 0, gain[ring] * uneven - 1))
        )
        more = np.where(setting.oval > 0, more + _bend(candidate, level), 0)
        candidate = _measured(index, candidate.luminance + more, setting)
    return best[1]


def _bend(candidate: Matched, level: _Level) -> Array:
    """(y, x) luminance to add for the contrast of code values to be right; mean and contrast of luminance stay.

    It goes along the part of the code values that is on no line through luminance.
    """
    inside, encoding = level.setting.oval > 0, level.setting.encoding
    light = np.clip(candidate.luminance[inside], 0, 1)
    code = encoding.code(light)
    middle, spread = light - light.mean(), code - code.mean()
    along = spread - middle * ((spread @ middle) / (middle @ middle))
    along /= max(float(np.abs(along).max()), 1e-9)
    slope = (encoding.code(light + _SMALL_LIGHT * along).std() - code.std()) / _SMALL_LIGHT
    out = np.zeros(candidate.luminance.shape)
    if slope > 1:  # code values that are linear in luminance have none
        lacking = level.target[3] - candidate.figures.contrast_code
        out[inside] = along * np.clip(_SMALL_STEP * lacking / slope, -0.01, 0.01)
    return out


def _spread(candidate: Matched, level: _Level) -> float:
    """The power to which amplitudes, over their ring's mean, are raised for the contrast to be right."""
    ratio = level.target[1] / candidate.figures.contrast_linear
    return float(np.clip(_SMALL_STEP * np.log(ratio), -0.2, 0.2))


def _lacking(candidate: Matched, target: Array, step: float) -> Array:
    """(ring - 1,) what to multiply each ring by, from the first on."""
    return np.asarray(np.clip(candidate.spectrum / target, 0.2, 5)[_LEAST_RING:] ** -step)


def _worst(candidate: Matched, target: Array, level: _Level) -> float:
    """How far a picture is from the set, in parts of what is enough."""
    rings_off = np.abs(candidate.spectrum / target - 1)[_LEAST_RING:].max()
    return max(float(rings_off) / ENOUGH_SPECTRUM, level.off(candidate) / ENOUGH_LEVELS)


def apart(matched: Sequence[Matched]) -> dict[str, float]:
    """How unlike the pictures of a set are: the largest difference between any two by figure, in grey levels.

    `spectrum` is how far a ring of any picture is from the set's mean of that ring, as a part of it.
    """
    rows = np.array([face.figures for face in matched])
    spectra = np.stack([face.spectrum for face in matched])[:, _LEAST_RING:]
    ranges = dict(zip(Figures._fields, map(float, np.ptp(rows, axis=0)), strict=True))
    return {**ranges, "spectrum": float(np.abs(spectra / spectra.mean(axis=0) - 1).max())}
