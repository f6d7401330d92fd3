"""How the bands of a set lie to each other: one flow per band, from the band that the others are brought to.

`band_alignment.py` finds them; the equation is in `stages/align.py`.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lightstage.kernels.motion import band_alignment
from lightstage.kernels.motion.flow_warp import seen, warp
from lightstage.kernels.motion.shots import DOUBTED, UNKNOWN, Image, Shots


class BandWays(NamedTuple):
    """The flows, and what a result says of them."""

    flows: Sequence[Image | None]
    """(xy, y, x) of each band, None where it stays as it is."""
    results: Mapping[str, Image]
    """`band_flow` (band, xy, y, x) and `band_confidence` (band, y, x), where bands were aligned."""
    stats: Mapping[str, float]
    """What each was found from."""
    warnings: Sequence[str]

    def moved(
        self, bands: Sequence[Image], flow: Image | None = None, components: int | None = None
    ) -> list[Image]:
        """One picture, band by band, brought to the reference band, and along a flow if there is one.

        Args:
            bands: (component, y, x) each.
            flow: (xy, y, x), pixels, on the reference band's grid.
            components: how many of them, the first ones; all where it is None.
        """
        out = []
        for band, across in zip(bands, self.flows, strict=True):
            way = across if flow is None else flow if across is None else flow + warp(across, flow)
            out.append(band[:components] if way is None else warp(band[:components], way))
        return out


def still_bands(count: int) -> BandWays:
    """Bands that are taken as they are."""
    return BandWays([None] * count, {}, {}, [])


def find_band_ways(
    pictures: Mapping[str, Sequence[Image]], shots: Shots, *, bands: str, reference: int, still: bool
) -> BandWays:
    """The flow of every band to one of them.

    Args:
        pictures: of the set by illumination: of each band (component, y, x).
        shots: which bands and components these are.
        bands: auto, specular, relief or gradient: what they are aligned by.
        reference: number of the band that the others are brought to.
        still: whether the subject held still within the set.
    """
    count = len(shots.bands_nm)
    light = [
        band_alignment.gathered({name: bands[b] for name, bands in pictures.items()}, shots.components, still=still)
        for b in range(count)
    ]
    kinds = [kind for kind in band_alignment.KINDS if bands in ("auto", kind)]
    shape = light[reference].diffuse.shape
    flows: list[Image | None] = [None] * count
    flow = np.zeros((count, 2, *shape), np.float32)
    confidence = np.ones((count, *shape), np.float32)
    stats: dict[str, float] = {}
    warnings = []
    for b, band_nm in enumerate(shots.bands_nm):
        if b == reference:
            continue
        way = band_alignment.band_flow(light[reference], light[b], kinds=kinds)
        if not way.parts:
            confidence[b] = UNKNOWN
            warnings.append(
                f"{band_nm:g} nm shows nothing by which it could be aligned to {shots.bands_nm[reference]:g} nm "
                f"(bands: {bands}; texture correlates by {way.alike:.2f}); it stays as it is"
            )
            continue
        flow[b] = flows[b] = way.flow
        confidence[b] = np.maximum(1 / (1 + way.doubt_px**2), DOUBTED) * seen(way.flow)
        stats |= {f"aligned_on_{kind}_{band_nm:g}nm": part for kind, part in way.parts.items()}
    return BandWays(flows, {"band_flow": flow, "band_confidence": confidence}, stats, warnings)
