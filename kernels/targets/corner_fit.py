"""The model of a checkerboard's corner, fitted to the pixels around it.

    I(p) = m + d E(s_1) E(s_2)        s_k = n_k · (p - c)        E(s) = ∫ erf(u / (√2 σ)) du, s - 1/2 to s + 1/2

c is the corner, n_k the normals of its two edges, σ their blur, m the mean level, d half the contrast. The window
is 0.8 of the squares around the corner, so nearly all of both edges counts and not only the pixels at the crossing;
it follows the board's perspective. The fit needs no threshold and no gradient of an aliased picture (cornerSubPix
errs by 0.03 to 0.1 px on a sharp one); it yields the corner's covariance and the sharpness, too.

E is the edge blurred by the lens (σ) and averaged over the pixel. Without the pixel's own part, sharp edges along
the grid, which all cross their pixels at the same place, are off by 0.05 px.

Limits: edges are straight within a window; squares measure 6 pixels or more; counts are linear (a gamma bends the
profiles of the edges, evenly on both sides of a corner, and costs little).

Sources: Gauss-Newton with Levenberg's damping; Golub & Pereyra (1973), doi:10.1137/0710036 (levels eliminated:
variable projection).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.float64]
_WINDOW = 0.8
"""Half-width of the fit, of the lattice's step: the next edges, blurred, must stay outside."""
_OUTLIER = 0.25
"""Residuals beyond this part of the contrast (and 6 root mean squares) are hot pixels or dust. Not the latter
alone: where most pixels are flat it throws out the edges' own misfit, which doubled the corners' error."""


def refine_corners(image: Array, lattice: Array, *, iterations: int = 20) -> tuple[Array, Array, Array]:
    """Fit the corner model around every lattice point.

    Args:
        image: (y, x), linear.
        lattice: (row, column, xy) within a pixel or a tenth of a square, whichever is more.

    Returns:
        points (row, column, xy), covariance (row, column, 2, 2), blur (row, column) in pixels; NaN where the fit
        failed.
    """
    gradient_x, gradient_y = np.gradient(lattice, axis=1), np.gradient(lattice, axis=0)
    points = np.full(lattice.shape, np.nan)
    covariance = np.full((*lattice.shape[:2], 2, 2), np.nan)
    blur = np.full(lattice.shape[:2], np.nan)
    for index in np.ndindex(lattice.shape[:2]):
        fit = _fit(image, lattice[index], gradient_x[index], gradient_y[index], iterations)
        if fit is not None:
            points[index], covariance[index], blur[index] = fit
    return points, covariance, blur


def _fit(
    image: Array, start: Array, along: Array, down: Array, iterations: int
) -> tuple[Array, Array, float] | None:
    step = np.stack([along, down], 1)
    reach = np.ceil(_WINDOW * np.abs(step).sum(1)).astype(int)
    middle = np.round(start).astype(int)
    low = np.maximum(middle - reach, 0)
    high = np.minimum(middle + reach, np.array(image.shape[::-1]) - 1)
    if (high - low < 3).any():
        return None
    y, x = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    places = np.stack([x.ravel(), y.ravel()], 1).astype(float)
    inside = (np.abs(np.linalg.solve(step, (places - start).T)) <= _WINDOW).all(0)
    places, values = places[inside], image[y.ravel()[inside], x.ravel()[inside]]
    parameters = np.array([*start, np.arctan2(along[1], along[0]), np.arctan2(down[1], down[0]), np.log(0.3)])
    try:
        parameters, residual, jacobian = _minimise(places, values, parameters, iterations)
        contrast = float(np.subtract(*np.percentile(values, [95, 5])))
        good = np.abs(residual) <= max(_OUTLIER * contrast, 6 * float(np.sqrt((residual**2).mean())))
        if not good.all():
            parameters, residual, jacobian = _minimise(places[good], values[good], parameters, iterations)
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return None
    variance = float((residual**2).sum()) / max(residual.size - 7, 1)
    return parameters[:2], np.asarray(inverse[:2, :2] * variance), float(np.exp(parameters[4]))


def _minimise(places: Array, values: Array, start: Array, iterations: int) -> tuple[Array, Array, Array]:
    """Parameters, residuals and derivatives at the least sum of squares."""
    parameters, trial = start, start
    residual, jacobian = _model(places, values, start)
    best, damping = np.inf, 1e-3
    for _ in range(iterations):
        tried = _model(places, values, trial)
        cost = float((tried[0] ** 2).sum())
        if cost < best:
            done = best - cost < 1e-6 * cost
            best, parameters, (residual, jacobian) = cost, trial, tried
            damping = max(damping / 5, 1e-9)
            if done:
                break
        else:
            damping *= 10
        normal = jacobian.T @ jacobian
        normal[np.diag_indices(5)] *= 1 + damping
        step = np.linalg.solve(normal, jacobian.T @ residual)
        if np.abs(step[:2]).max() < 1e-5:
            break
        trial = parameters - step
        trial[4] = np.clip(trial[4], np.log(0.1), np.log(5.0))
    return parameters, residual, jacobian


def _model(places: Array, values: Array, parameters: Array) -> tuple[Array, Array]:
    """Residuals (n) and their derivatives (n, 5) by x, y, the two angles and log σ; levels are solved inside."""
    sigma = np.exp(parameters[4])
    offset = places - parameters[:2]
    edges, slopes, derivatives = [], [], []
    for angle in parameters[2:4]:
        normal = np.array([-np.sin(angle), np.cos(angle)])
        s = offset @ normal
        far, near = s + 0.5, s - 0.5
        steps = erf(far / (np.sqrt(2) * sigma)), erf(near / (np.sqrt(2) * sigma))
        # sqrt(2 / pi) exp(...) is how the integral of erf changes with sigma, and part of that integral
        bells = [np.sqrt(2 / np.pi) * sigma * np.exp(-0.5 * (u / sigma) ** 2) for u in (far, near)]
        edges.append(far * steps[0] - near * steps[1] + bells[0] - bells[1])
        slopes.append(steps[0] - steps[1])
        derivatives.append((normal, -(offset @ np.array([np.cos(angle), np.sin(angle)])), bells[0] - bells[1]))
    product = edges[0] * edges[1]
    # levels are linear, so they are solved for exactly at every step (variable projection)
    base = np.stack([np.ones_like(product), product], 1)
    level, *_ = np.linalg.lstsq(base, values, rcond=None)
    first, second = slopes[0] * edges[1], edges[0] * slopes[1]
    (n1, a1, widening1), (n2, a2, widening2) = derivatives
    inner = (
        np.stack(
            [
                -(first * n1[0] + second * n2[0]),
                -(first * n1[1] + second * n2[1]),
                first * a1,
                second * a2,
                widening1 * edges[1] + edges[0] * widening2,
            ],
            1,
        )
        * level[1]
    )
    inner -= base @ np.linalg.lstsq(base, inner, rcond=None)[0]
    return base @ level - values, inner
