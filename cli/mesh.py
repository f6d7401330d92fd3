"""Meshes of a height map: PLY, OBJ and GLB, through trimesh.

World frame, right-handed, x right, y up, z towards the camera, faces counter-clockwise as the camera sees them. PLY
and OBJ are in millimetres, GLB in metres, because glTF demands it. A triangle that the camera sees edge-on spans a
discontinuity and is left out.

The texture is the albedo of the node `reflectance` in colour, or that of the node `relief`, or none, whichever has
a result. GLB carries a tangent-space normal map (green up): its vertices have the smooth surface's normals, and the
map what the measured normals have beyond them. PLY has its colours at the vertices.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.show import Screen
from store.errors import RequestError, WorkError
from store.root import Store
from store.sessions import Session

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from stages.pinhole import Pinhole

FORMATS = ("ply", "obj", "glb")
_EDGE_ON = 0.06
"""Least cosine between a triangle and the view: 86.5 degrees."""
_SMOOTH_PX = 2.0
"""Sigma of the blur that makes the smooth surface's normals."""


@dataclass(frozen=True)
class Surface:
    """A triangle mesh on the pixels of a picture."""

    vertices: "NDArray[np.float64]"
    """(vertex, xyz) world, mm."""
    faces: "NDArray[np.int64]"
    """(face, 3), counter-clockwise to the camera."""
    normals: "NDArray[np.float64]"
    """(vertex, xyz), of the smooth surface."""
    pixels: "NDArray[np.int64]"
    """(vertex, 2): row and column of each."""
    shape: tuple[int, int]
    """Rows and columns of the picture."""

    @property
    def uv(self) -> "NDArray[np.float64]":
        """(vertex, 2): texture coordinates, the origin at the lower left."""
        import numpy as np

        rows, columns = self.shape
        return np.stack([(self.pixels[:, 1] + 0.5) / columns, 1 - (self.pixels[:, 0] + 0.5) / rows], axis=1)


def surface_of(depth_mm: "NDArray[np.float64]", camera: "Pinhole", *, every: int = 1) -> Surface:
    """Triangles over every `every`th pixel of a height map.

    Args:
        depth_mm: (y, x) camera z, NaN off the subject.
        camera: of the picture.

    Raises:
        RequestError: no triangle is left.
    """
    import numpy as np

    points = camera.points(depth_mm)
    smooth = smooth_normals(points, np.isfinite(depth_mm))
    rows, columns = np.arange(0, depth_mm.shape[0], every), np.arange(0, depth_mm.shape[1], every)
    grid = points[np.ix_(rows, columns)]
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate(
        [np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([b, c, d], axis=-1).reshape(-1, 3)]
    )
    flat = grid.reshape(-1, 3)
    faces = faces[np.isfinite(flat[faces]).all(axis=(1, 2))]
    corners = flat[faces]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    view = camera.centre - corners.mean(axis=1)
    size = np.linalg.norm(turned, axis=1) * np.linalg.norm(view, axis=1)
    faces = faces[np.einsum("ij,ij->i", turned, view) > _EDGE_ON * np.maximum(size, 1e-12)]
    if not len(faces):
        raise RequestError("the height map has no two neighbouring points, so there is no mesh of it")
    used, places = np.unique(faces, return_inverse=True)
    pixels = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)[used]
    return Surface(
        flat[used],
        places.reshape(-1, 3),
        smooth[pixels[:, 0], pixels[:, 1]],
        pixels,
        (depth_mm.shape[0], depth_mm.shape[1]),
    )


def smooth_normals(points: "NDArray[np.float64]", mask: "NDArray[np.bool_]") -> "NDArray[np.float64]":
    """(y, x, xyz) normals of a surface given as points (y, x, xyz), a little blurred; (0, 0, 1) off the mask."""
    import cv2
    import numpy as np

    from stages.rig_normals import surface_normals

    unit = np.nan_to_num(surface_normals(points, mask))
    blurred = np.stack([cv2.GaussianBlur(unit[..., i], (0, 0), _SMOOTH_PX) for i in range(3)], axis=-1)
    length = np.linalg.norm(blurred, axis=2, keepdims=True)
    return np.where(length > 1e-6, blurred / np.maximum(length, 1e-6), np.array([0.0, 0.0, 1.0]))


def tangent_space(
    normal: "NDArray[np.float64]", points: "NDArray[np.float64]", mask: "NDArray[np.bool_]"
) -> "NDArray[np.float64]":
    """Measured normals (y, x, xyz) in the frame of the smooth surface: tangent to the right, bitangent up, normal.

    (0, 0, 1) where either is not known.
    """
    import numpy as np

    smooth = smooth_normals(points, mask)
    along = np.gradient(np.where(mask[..., None], points, 0), axis=1)
    along = np.where(np.isfinite(along) & mask[..., None], along, np.array([1.0, 0.0, 0.0]))
    tangent = along - np.einsum("yxi,yxi->yx", along, smooth)[..., None] * smooth
    tangent /= np.maximum(np.linalg.norm(tangent, axis=2, keepdims=True), 1e-9)
    frame = np.stack([tangent, np.cross(smooth, tangent), smooth], axis=2)
    seen = np.einsum("yxji,yxi->yxj", frame, np.nan_to_num(normal))
    known = np.isfinite(normal).all(axis=2) & mask & (seen[..., 2] > 0)
    return np.where(known[..., None], seen, np.array([0.0, 0.0, 1.0]))


def write_mesh(
    file: Path,
    surface: Surface,
    *,
    base_colour: "NDArray[np.float64] | None" = None,
    normal_map: "NDArray[np.float64] | None" = None,
    roughness: float = 0.6,
) -> list[Path]:
    """Write a mesh by the file's extension; returns the files written.

    Args:
        base_colour: (y, x, rgb) linear sRGB, 0..1.
        normal_map: (y, x, xyz) in tangent space; GLB alone carries it.

    Raises:
        WorkError: a file cannot be written.
    """
    import numpy as np
    import trimesh
    from PIL import Image
    from trimesh.visual.material import PBRMaterial, SimpleMaterial

    from stages.colour import encode_srgb

    form = file.suffix[1:]
    scale = 0.001 if form == "glb" else 1.0
    code = None if base_colour is None else np.round(255 * encode_srgb(base_colour)).astype(np.uint8)
    visual: Any = None
    if form == "ply" and code is not None:
        visual = trimesh.visual.ColorVisuals(vertex_colors=code[surface.pixels[:, 0], surface.pixels[:, 1]])
    elif form == "glb":
        maps: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": roughness, "doubleSided": False}
        if code is not None:
            maps["baseColorTexture"] = Image.fromarray(code)
        if normal_map is not None:
            maps["normalTexture"] = Image.fromarray(np.round(127.5 * (normal_map + 1)).astype(np.uint8))
        visual = trimesh.visual.TextureVisuals(uv=surface.uv, material=PBRMaterial(**maps))
    elif code is not None:
        material = SimpleMaterial(image=Image.fromarray(code), name=file.stem)
        visual = trimesh.visual.TextureVisuals(uv=surface.uv, material=material)
    mesh = trimesh.Trimesh(
        scale * surface.vertices, surface.faces, vertex_normals=surface.normals, visual=visual, process=False
    )
    if form == "obj":
        text, parts = trimesh.exchange.obj.export_obj(
            mesh, include_texture=True, return_texture=True, include_normals=True, mtl_name=f"{file.stem}.mtl"
        )
        contents = {file.name: text.encode(), **parts}
    else:
        contents = {file.name: mesh.export(file_type=form)}
    written = []
    for name, content in contents.items():
        target = file.with_name(name)
        temporary = target.with_name(f".{name}.part")
        try:
            temporary.write_bytes(content)
            os.replace(temporary, target)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise WorkError(f"{target} cannot be written ({error.strerror or error})") from None
        written.append(target)
    return written


def export_meshes(
    dataset: Any, node: str, session: Session, to: Path, screen: Screen, store: Store, *, form: str, every: int
) -> Mapping[str, Any]:
    """One mesh per tracking frame of a node that has depth; returns what `export` answers.

    Raises:
        RequestError: the node has no depth, or the session no camera.
    """
    import numpy as np

    from dag.plan import bound_items
    from stages.pinhole import Pinhole

    if "depth_mm" not in dataset:
        raise RequestError(
            f"node '{node}' has no depth, so there is no mesh of it; `lightstage export shape` has one"
        )
    items = bound_items(session, store, {})
    if "camera" not in items:
        raise RequestError(f"session '{session.name}' has no camera item, which places points in millimetres")
    rows, columns = dataset.sizes["y"], dataset.sizes["x"]
    camera = Pinhole.of(items["camera"].values, (rows, columns))
    files: list[str] = []
    frames = [int(t) for t in dataset.tracking.values]
    for k, frame in enumerate(screen.progress(frames, len(frames), "meshes")):
        depth = dataset.depth_mm.values[k].astype(np.float64)
        normal_map = None
        measured = _at(session, store, ("relief", "normals"), "normal", frame)
        if form == "glb" and measured is not None:
            unit = np.moveaxis(measured[0], 0, 2).astype(np.float64)
            normal_map = tangent_space(unit, camera.points(depth), np.isfinite(depth))
        made = write_mesh(
            to / f"{node}_tracking{frame:04d}.{form}",
            surface_of(depth, camera, every=every),
            base_colour=_colour(session, store, items, frame),
            normal_map=normal_map,
        )
        files += map(str, made)
    unit_name = "metres" if form == "glb" else "millimetres"
    screen.say(f"{len(frames)} meshes of {node} ({session.name}) in {to}, in {unit_name}")
    return {"files": files, "format": form, "unit": unit_name}


def _at(session: Session, store: Store, nodes: Sequence[str], array: str, frame: int) -> Any:
    """The array of the first of these nodes that has a result with it, at a tracking frame; None without."""
    from store.grid import open_dataset
    from store.results import current

    for node in nodes:
        folder = current(session.name, node, store)
        if folder is None:
            continue
        dataset = open_dataset(store.results / session.name / node / folder)
        if array in dataset and frame in dataset.tracking.values:
            return dataset[array].sel(tracking=frame).values
    return None


def _colour(session: Session, store: Store, items: Mapping[str, Any], frame: int) -> Any:
    """Albedo as linear sRGB (y, x, rgb); None where no node has one."""
    import numpy as np

    from stages.colour import linear_srgb_matrix

    bands = list(session.facts["bands_nm"])
    albedo = _at(session, store, ("reflectance",), "reflectance", frame)
    if albedo is None:
        albedo = _at(session, store, ("relief", "normals"), "albedo", frame)
        if albedo is None:
            return None
        bands = bands if len(albedo) == len(bands) else [0.0]
        bright = np.nanpercentile(albedo, 99.5) if np.isfinite(albedo).any() else 1.0
        albedo = 0.8 * albedo / max(float(bright), 1e-9)
    widths = {entry["centre_nm"]: entry.get("width_nm") for entry in _bands(items)}
    matrix = linear_srgb_matrix(bands, [widths.get(band) for band in bands])
    return np.einsum("cb,byx->yxc", matrix, np.nan_to_num(albedo).astype(np.float64))


def _bands(items: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    return items["bands"].values["bands"] if "bands" in items else ()
