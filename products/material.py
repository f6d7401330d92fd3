"""A material: what a renderer needs of a subject, as EXR maps and as a GLB with a glTF PBR material.

Base colour is the diffuse albedo of all bands, seen in colour (`kernels/appearance/colour.py`); it lies beside
the bands themselves. Maps are padded beyond the subject with what is nearest, so that filtering brings in no
background; the mask says where the subject is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightstage.formats.exr import COLOUR, DATA, REC709, rgb, spectral, write_exr
from lightstage.kernels.appearance.colour import linear_srgb_matrix
from lightstage.kernels.appearance.microfacets import at_normal_incidence
from lightstage.kernels.surface.pinhole import Pinhole
from lightstage.kernels.surface.triangles import smooth_frames, tangent_space, triangulate
from lightstage.products import names
from lightstage.products.choices import FRAME
from lightstage.products.errors import ProductError
from lightstage.products.mesh import ROUGHNESS, Paint, filled, mesh_files
from lightstage.products.tracking import tracking_frame

Array = NDArray[np.float64]
Entry = dict[str, Any]
"""What the record says of a file."""
FORMAT = "lightstage-material/1"
GLTF_NORMAL_INCIDENCE = 0.04
"""What glTF takes for the reflectance at normal incidence where the specular factor is 1."""
NODES = ("reflectance", "relief", "shape")
"""That a material is made of."""
GLOSS_NODES = ("specular", "gloss")
"""And these, which need both polarisations."""


@dataclass(frozen=True)
class Gloss:
    """The specular component; maps are NaN where not known."""

    specular: Array
    """(y, x): reflectance at normal incidence."""
    alpha: Array
    """(y, x): GGX width."""
    normal: Array
    """(y, x, xyz), world."""
    index: float
    """Refractive, as `gloss` took it."""
    absolute: bool
    """Else the median of `specular` is set to that of the index."""


@dataclass(frozen=True)
class Material:
    """One tracking frame of a subject, measured. Maps are (y, x, ...), NaN where not known."""

    session: str
    tracking: int
    bands_nm: tuple[float, ...]
    widths_nm: tuple[float | None, ...]
    reflectance: Array
    """(band, y, x)."""
    absolute: bool
    """Whether 1 is a perfect white; else it is the brightest point."""
    normal: Array
    """(y, x, xyz), of the diffuse component, world."""
    depth_mm: Array
    """(y, x), camera z."""
    edge: NDArray[np.uint8]
    camera: Pinhole
    gloss: Gloss | None
    """None where the capture lacks one of the polarisations."""
    recipes: Mapping[str, str]
    """Node to the folder of its result."""

    @property
    def known(self) -> NDArray[np.bool_]:
        """(y, x): the subject, where it has albedo, normal and depth."""
        inside = np.isfinite(self.reflectance).all(axis=0) & np.isfinite(self.depth_mm)
        return np.asarray(inside & np.isfinite(self.normal).all(axis=2))

    @property
    def colour(self) -> Array:
        """(y, x, rgb): linear Rec. 709 under D65, grey of one band; negative where a colour is beyond it."""
        matrix = linear_srgb_matrix(self.bands_nm, self.widths_nm)
        return np.moveaxis(np.tensordot(matrix, self.reflectance, 1), 0, 2)


def read_material(
    results: Mapping[str, Any],
    recipes: Mapping[str, str],
    camera_item: Mapping[str, Any],
    bands: Sequence[Mapping[str, Any]],
    *,
    session: str,
    tracking: int | None,
) -> Material:
    """What is known of a tracking frame.

    Args:
        results: opened, by node: NODES, and GLOSS_NODES where the capture has both polarisations.
        recipes: the folder of each node's result.
        camera_item: of the pictures.
        bands: entries of the bands item, as far as there is one.
        session: its name.
        tracking: the frame; None for the first.

    Raises:
        ProductError: there is no such tracking frame, or nothing is known of the subject.
        KernelError: the camera item is for pictures of another size.
    """
    frame = tracking_frame(results, "shape", session, tracking)
    chosen = {node: dataset.sel(tracking=frame) for node, dataset in results.items()}
    bands_nm = tuple(float(nm) for nm in chosen["reflectance"]["band"].values)
    widths = {float(entry["centre_nm"]): entry["width_nm"] for entry in bands}

    def picture(node: str, name: str) -> Array:
        return np.asarray(chosen[node][name].values, np.float64)

    depth = picture("shape", "depth_mm")
    material = Material(
        session,
        frame,
        bands_nm,
        tuple(widths.get(nm) for nm in bands_nm),
        picture("reflectance", "reflectance"),
        results["reflectance"].attrs["scale"] == "absolute",
        np.moveaxis(picture("relief", "normal")[0], 0, 2),
        depth,
        np.asarray(chosen["shape"]["edge"].values),
        Pinhole.of(camera_item, (depth.shape[0], depth.shape[1])),
        None,
        dict(recipes),
    )
    if not material.known.any():
        raise ProductError(f"session '{session}' has no pixel with albedo, normal and depth")
    if "gloss" not in chosen:
        return material
    gloss = _gloss(
        picture("gloss", "specular"),
        picture("gloss", "roughness"),
        np.moveaxis(picture("specular", "normal")[0], 0, 2),
        np.isfinite(depth),
        results["gloss"].attrs,
    )
    return replace(material, gloss=gloss)


def _gloss(
    specular: Array, alpha: Array, normal: Array, known: NDArray[np.bool_], attrs: Mapping[str, Any]
) -> Gloss:
    index, absolute = float(attrs["index"]), attrs["scale"] == "absolute"
    if not absolute:
        # of the subject: a background that shines nowhere has a number too
        specular = specular * (at_normal_incidence(index) / np.nanmedian(specular[known]))
    return Gloss(specular, alpha, normal, index, absolute)


def write_material(folder: Path, material: Material, formats: Sequence[str]) -> dict[str, Entry]:
    """Write the maps and the mesh; returns what each file is.

    Args:
        folder: is there.
        material: see there.
        formats: of `choices.MATERIAL_FORMATS`.

    Raises:
        OSError: a file cannot be written.
    """
    files: dict[str, Entry] = {}
    if "exr" in formats:
        files |= _write_maps(folder, material)
    if "glb" in formats:
        files |= _write_glb(folder, material)
    return files


def document(material: Material) -> dict[str, Any]:
    """What the record says of all files."""
    return {
        "format": FORMAT,
        "session": material.session,
        "tracking": material.tracking,
        "frame": FRAME,
        "scale": "absolute: 1 is a perfect white" if material.absolute else "relative: 1 is the brightest point",
        "beyond the subject": "padded with what is nearest; mask.exr is 1 on the subject",
        "results": dict(material.recipes),
    }


def _write_maps(folder: Path, material: Material) -> dict[str, Entry]:
    """The EXR files; returns what each is."""
    known, gloss = material.known, material.gloss
    files: dict[str, Entry] = {}

    def padded(values: Array) -> Array:
        """(y, x) or (y, x, channel), from what is nearest on the subject."""
        layers = values[..., None] if values.ndim == 2 else values
        whole = filled(np.where(known[..., None], layers, np.nan))
        return np.asarray(whole[..., 0] if values.ndim == 2 else whole)

    def write(name: str, channels: Mapping[str, Any], what: str, units: str, **more: Any) -> None:
        colour = more.pop("colour", DATA)
        write_exr(folder / name, channels, colour=colour, units=units, session=material.session, **more)
        files[name] = {"what": what, "channels": list(channels), "units": units, "colorInteropID": colour, **more}

    def unit(normal: Array) -> Array:
        vectors = padded(normal)
        return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-9))

    bands = np.moveaxis(padded(np.moveaxis(material.reflectance, 0, 2)), 2, 0)
    write(names.BASE_COLOUR, rgb(padded(material.colour)), "diffuse albedo in colour", "1", colour=COLOUR)
    files[names.BASE_COLOUR]["chromaticities"] = REC709
    widths = ", ".join("?" if width is None else f"{width:g}" for width in material.widths_nm)
    write(
        names.BANDS,
        spectral(bands, material.bands_nm),
        "diffuse albedo in each band; a channel's name is its wavelength",
        "1",
        width_nm=widths,
    )
    encoding = {"frame": FRAME, "encoding": "signed: R, G, B are x, y, z from -1 to 1"}
    write(names.NORMAL_DIFFUSE, rgb(unit(material.normal)), "normals of the diffuse component", "1", **encoding)
    write(names.DEPTH, {"Z": padded(material.depth_mm)}, "camera z of the surface", "mm")
    write(names.MASK, {"Y": known.astype(np.float64)}, "1 on the subject, 0 where maps are padded", "1")
    if gloss is not None:
        scale = "absolute" if gloss.absolute else "relative: the median is set to the index's"
        write(
            names.SPECULAR,
            {"Y": padded(gloss.specular)},
            "specular reflectance at normal incidence",
            "1",
            scale=scale,
            refractive_index=gloss.index,
        )
        write(
            names.ROUGHNESS,
            {"Y": np.sqrt(padded(gloss.alpha))},
            "roughness of renderers: the square root of the GGX width",
            "1",
        )
        write(names.NORMAL_SPECULAR, rgb(unit(gloss.normal)), "normals of the specular component", "1", **encoding)
    return files


def _write_glb(folder: Path, material: Material) -> dict[str, Entry]:
    """The mesh with its material; returns what it is."""
    known, gloss = material.known, material.gloss
    base = np.where(known[..., None], material.colour, np.nan)
    frames = smooth_frames(material.depth_mm, material.camera)
    rough = factor = None
    entry: Entry = {
        "what": "mesh with base colour, normal map and, where measured, roughness and specular factor",
        "units": "metres",
        "frame": FRAME,
        "base colour": "sRGB, 8 bits, clipped to 0..1",
        "normal map": "tangent space, green up: the diffuse normals",
        "clipped base colour": _share((base < 0) | (base > 1), known),
    }
    if gloss is not None:
        rough = np.stack([np.zeros(known.shape), np.sqrt(gloss.alpha)], axis=-1)
        factor = gloss.specular / GLTF_NORMAL_INCIDENCE
        entry["roughness"] = "green of metallicRoughnessTexture, linear: the square root of the GGX width"
        entry["specular"] = (
            f"KHR_materials_specular: alpha of specularTexture is the reflectance at normal incidence over "
            f"{GLTF_NORMAL_INCIDENCE}, at most 1"
        )
        entry["clipped specular"] = _share(factor > 1, known)
    else:
        entry["roughness"] = f"{ROUGHNESS}, not measured"
    paint = Paint(base, tangent_space(material.normal, frames), rough, factor)
    surface = triangulate(material.depth_mm, material.camera, edge=material.edge)
    for name, data in mesh_files(Path(names.MATERIAL_MESH).stem, "glb", surface, paint).items():
        (folder / name).write_bytes(data)
    return {names.MATERIAL_MESH: entry}


def _share(where: NDArray[np.bool_], known: NDArray[np.bool_]) -> float:
    """Of the subject's pixels, rounded."""
    return round(float(where[known].mean()), 5)
