"""Meshes of a height map: PLY, OBJ and GLB, in the world frame (`kernels/surface/triangles.py`).

The texture is the albedo of the node `reflectance` in colour, or that of the node `relief` or `normals`, or none,
whichever there is; in sRGB, filled beyond the subject so that filtering brings in no background.

A normal map holds the measured normals: in *tangent* space (green up) what they have beyond the smooth surface's
normals, which the vertices then carry; in *object* space, the world's axes, they are whole. Without a map the
vertices carry the measured normals themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.formats import meshes
from lightstage.kernels.appearance.colour import linear_srgb_matrix
from lightstage.kernels.pictures.nearest_fill import nearest_fill
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.triangles import Surface, smooth_frames, tangent_space, triangulate
from lightstage.products import names
from lightstage.products.counts import counts_8, srgb_8
from lightstage.products.progress import Progress, silent

Array = NDArray[np.float64]
ROUGHNESS = 0.6
"""Of a material whose gloss was not measured: skin, about."""
_BRIGHT, _SHOWN = 99.5, 0.8
"""An albedo without a scale: this percentile of it is painted as so much of white."""


@dataclass(frozen=True)
class Paint:
    """What a surface is painted with. Maps lie on the picture's pixels; NaN is filled from what is nearest."""

    base_colour: Array | None = None
    """(y, x, rgb) linear sRGB, 0..1."""
    normal_map: Array | None = None
    """(y, x, xyz), in tangent space or, in OBJ, in the world's axes."""
    metallic_roughness: Array | None = None
    """(y, x, 2) metallic and roughness, 0..1; GLB alone has it."""
    specular: Array | None = None
    """(y, x) strength of the reflection, 0..1; GLB alone has it."""


@dataclass(frozen=True)
class Beside:
    """What there is of a session beside the depth: opened results by node, and its bands."""

    results: Mapping[str, Any]
    """Datasets of the nodes `reflectance`, `relief` and `normals`, of those that have a result."""
    bands_nm: Sequence[float]
    widths_nm: Mapping[float, float | None]
    """Of the pass band, by its centre, as far as the bands item says."""

    def at(self, nodes: Sequence[str], array: str, frame: int) -> Any:
        """The array of the first of these nodes that has it at a tracking frame; None without."""
        for node in nodes:
            dataset = self.results.get(node)
            if dataset is not None and array in dataset and frame in dataset.tracking.values:
                return dataset[array].sel(tracking=frame).values
        return None


def write_meshes(
    folder: Path,
    node: str,
    dataset: Any,
    camera: Pinhole,
    beside: Beside,
    *,
    form: str,
    every: int = 1,
    space: str | None = None,
    progress: Progress = silent,
) -> list[str]:
    """Write one mesh per tracking frame into a folder; returns the files' names, each mesh before what it names.

    Args:
        folder: is there.
        node: of the depth, for the files' names.
        dataset: with `depth_mm(tracking, y, x)` and, if known, `edge`.
        camera: of its pictures.
        beside: what the meshes are painted with.
        form: one of `formats.meshes.FORMATS`.
        every: vertices are every so many pixels.
        space: of the normal map; None: no map.
        progress: shows how far it is.

    Raises:
        KernelError: there is no surface.
        OSError: a file cannot be written.
    """
    written: list[str] = []
    frames = [int(t) for t in dataset.tracking.values]
    for k, frame in enumerate(progress(frames, len(frames), "meshes")):
        depth = dataset.depth_mm.values[k].astype(np.float64)
        measured = beside.at(("relief", "normals"), "normal", frame)
        normal = normal_map = None
        if measured is not None and measured.shape[-2:] == depth.shape:
            normal = np.moveaxis(measured[0], 0, 2).astype(np.float64)
        if normal is not None and space is not None:
            smooth = smooth_frames(depth, camera, every=every)
            normal_map = tangent_space(normal, smooth) if space == "tangent" else normal
        surface = triangulate(
            depth,
            camera,
            every=every,
            edge=dataset["edge"].values[k] if "edge" in dataset else None,
            normal=normal if normal_map is None else None,
        )
        paint = Paint(_colour(beside, frame), normal_map)
        files = mesh_files(names.mesh(node, frame), form, surface, paint, space=space)
        for name, data in files.items():
            (folder / name).write_bytes(data)
        mesh = f"{names.mesh(node, frame)}.{form}"
        written += [mesh, *(name for name in files if name != mesh)]
    return written


def mesh_files(
    name: str, form: str, surface: Surface, paint: Paint, *, space: str | None = None, roughness: float = ROUGHNESS
) -> dict[str, bytes]:
    """A painted surface in a format: its files by name, the mesh last.

    Args:
        name: of the files, without extension.
        form: one of `formats.meshes.FORMATS`.
        surface: of `triangulate`.
        paint: see there; PLY has its base colour at the vertices.
        space: of the normal map: tangent or object.
        roughness: of the whole surface, where there is no map; GLB alone has it.
    """
    mesh = meshes.Mesh(surface.vertices, surface.faces, surface.normals, surface.tangents, surface.uv)
    colour = None if paint.base_colour is None else srgb_8(filled(paint.base_colour))
    rough = shine = None
    if paint.metallic_roughness is not None:
        metal = paint.metallic_roughness[..., 0]
        rough = _counts(np.stack([np.ones_like(metal), paint.metallic_roughness[..., 1], metal], axis=-1))
    if paint.specular is not None:
        strength = np.repeat(np.ones_like(paint.specular)[..., None], 4, axis=-1)
        strength[..., 3] = paint.specular
        shine = _counts(strength)
    bumps = None if paint.normal_map is None else _counts((paint.normal_map + 1) / 2)
    at_vertices = None if colour is None else colour[surface.pixels[:, 0], surface.pixels[:, 1]]
    return meshes.mesh_files(
        name,
        form,
        mesh,
        meshes.Textures(colour, bumps, rough, shine),
        colours=at_vertices,
        space=space,
        roughness=roughness,
    )


def filled(values: Array) -> Array:
    """(y, x, channel) with NaN filled from the nearest pixel; 0 where all is NaN."""
    known = np.asarray(np.isfinite(values).all(axis=-1))
    if not known.any():
        return np.nan_to_num(values)
    return np.moveaxis(nearest_fill(np.moveaxis(values, 2, 0), known), 0, 2)


def _counts(unit: Array) -> NDArray[np.uint8]:
    """(y, x, channel) in 0..1 as 8 bits; NaN is filled from what is nearest."""
    return counts_8(filled(unit))


def _colour(beside: Beside, frame: int) -> Array | None:
    """Albedo as linear sRGB (y, x, rgb), NaN where it is not known; None where no node has one."""
    bands = list(beside.bands_nm)
    albedo = beside.at(("reflectance",), "reflectance", frame)
    if albedo is None:
        albedo = beside.at(("relief", "normals"), "albedo", frame)
        if albedo is None:
            return None
        bands = bands if len(albedo) == len(bands) else [0.0]
        bright = np.nanpercentile(albedo, _BRIGHT) if np.isfinite(albedo).any() else 1.0
        albedo = _SHOWN * albedo / max(float(bright), 1e-9)
    matrix = linear_srgb_matrix(bands, [beside.widths_nm.get(band) for band in bands])
    return np.asarray(np.einsum("cb,byx->yxc", matrix, albedo.astype(np.float64)))
