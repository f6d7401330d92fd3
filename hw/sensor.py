"""The cameras: response, dark, noise and bits of a sensor, and its dark and flat frames.

    counts = round(dark + response x exposure x radiance + noise)

with shot noise from the electrons behind a count, read noise, a fixed pattern in dark and response, vignetting,
and a few hot pixels. Nothing is kept but integers from 0 to the top of the range.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

OFFSET = 16.0
"""Mean dark level, counts of a 10-bit sensor."""
BITS = 10
WHITE = (1 << BITS) - 1
ELECTRONS_PER_COUNT = 9.93
READ_NOISE_ELECTRONS = 10.0
FLAT_LEVEL = 0.7
"""Level of the flat frames, of the range above the dark."""
STORED_SCALE = 16
"""Dark and flat are means of many frames: stored as counts x 16."""


@dataclass(frozen=True)
class Sensor:
    """One camera's fixed pattern, (y, x), sensor orientation."""

    dark: NDArray[np.float64]
    response: NDArray[np.float64]

    @classmethod
    def made(cls, shape: tuple[int, int], generator: np.random.Generator) -> "Sensor":
        """A sensor of `shape` (rows, columns) with a pattern of its own and one hot pixel in 40,000."""
        rows, columns = shape
        y, x = np.mgrid[0:rows, 0:columns]
        radius = np.hypot((x - columns / 2) / columns, (y - rows / 2) / columns)
        vignetting = 1 - 0.27 * radius**2
        response = vignetting * (1 + 0.004 * generator.standard_normal(shape))
        dark = OFFSET + 0.4 * generator.standard_normal(shape)
        hot = generator.choice(rows * columns, max(1, rows * columns // 40000), replace=False)
        dark.reshape(-1)[hot] += generator.uniform(30, 150, hot.size)
        return cls(dark, response)

    def expose(self, signal: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.uint16]:
        """One picture of `signal` (y, x), counts of a perfect sensor."""
        electrons = np.clip(self.response * signal, 0, None) * ELECTRONS_PER_COUNT
        noisy = generator.poisson(electrons) + READ_NOISE_ELECTRONS * generator.standard_normal(signal.shape)
        counts = np.round(self.dark + noisy / ELECTRONS_PER_COUNT)
        return np.clip(counts, 0, WHITE).astype(np.uint16)

    def dark_frame(self) -> NDArray[np.uint16]:
        """Mean of many frames without light, x STORED_SCALE."""
        return np.round(self.dark * STORED_SCALE).astype(np.uint16)

    def flat_frame(self) -> NDArray[np.uint16]:
        """Mean of many frames of a uniform target, dark included, x STORED_SCALE."""
        level = FLAT_LEVEL * (WHITE - OFFSET)
        return np.round((self.dark + self.response * level) * STORED_SCALE).astype(np.uint16)
