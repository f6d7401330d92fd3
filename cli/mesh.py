"""Meshes of a height map: PLY, OBJ and GLB, through trimesh.

World frame, right-handed, x right, y up, z towards the camera, faces counter-clockwise as the camera sees them. PLY
and OBJ are in millimetres, GLB in metres, because glTF demands it. No triangle spans a break that `shape` has found
(its `edge`), nor one that the camera sees edge-on.

The texture is the albedo of the node `reflectance` in colour, or that of the node `relief`, or none, whichever has
a result; in sRGB, filled beyond the subject so that filtering brings in no background. PLY has its colours at the
vertices.

A normal map holds the measured normals: in *tangent* space (green up) what they have beyond the smooth surface's
normals, which the vertices then carry; in *object* space, the world's axes, they are whole. glTF knows the former
alone. Without a map the vertices carry the measured normals themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.show import Screen
from lightstage.formats.whole_file import write_whole
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL.Image import Image as Picture

    from lightstage.kernels.surface.pinhole import Pinhole
    from lightstage.store.sessions import Session

FORMATS = ("ply", "obj", "glb")
_EDGE_ON = 0.06
"""Least cosine between a triangle and the view: 86.5 degrees."""
_SMOOTH_PX = 2.0
"""Least sigma of the blur that makes the smooth surface's normals."""
ROUGHNESS = 0.6
"""Of a material whose gloss was not measured: skin, about."""
SPACES = ("tangent", "object")
_TANGENT = "_TANGENT"
_SPECULAR = "KHR_materials_specular"


@dataclass(frozen=True)
class Surface:
    """A triangle mesh on the pixels of a picture."""

    vertices: "NDArray[np.float64]"
    """(vertex, xyz) world, mm."""
    faces: "NDArray[np.int64]"
    """(face, 3), counter-clockwise to the camera."""
    normals: "NDArray[np.float64]"
    """(vertex, xyz), unit vectors, world."""
    tangents: "NDArray[np.float64]"
    """(vertex, xyz), unit vectors to the right in the picture, across `normals`."""
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


@dataclass(frozen=True)
class Frames:
    """The smooth surface at every pixel, (y, x, xyz) each: what a tangent-space normal map is relative to."""

    normal: "NDArray[np.float64]"
    tangent: "NDArray[np.float64]"
    """To the right in the picture, across the normal. The bitangent, normal x tangent, is up."""


def surface_of(
    depth_mm: "NDArray[np.float64]",
    camera: "Pinhole",
    *,
    every: int = 1,
    edge: "NDArray[np.uint8] | None" = None,
    normal: "NDArray[np.float64] | None" = None,
) -> Surface:
    """Triangles over every `every`th pixel of a height map.

    Args:
        depth_mm: (y, x) camera z, NaN off the subject.
        camera: of the picture.
        edge: (y, x) bits, 1 and 2 where the surface is broken to the right and below; None: nowhere.
        normal: (y, x, xyz) measured normals for the vertices, NaN where there is none; None: the smooth surface's.

    Raises:
        RequestError: no triangle is left.
    """
    import numpy as np

    points = camera.points(depth_mm)
    frames = smooth_frames(depth_mm, camera, every=every)
    rows, columns = np.arange(0, depth_mm.shape[0], every), np.arange(0, depth_mm.shape[1], every)
    grid = points[np.ix_(rows, columns)]
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    right, below = _links(depth_mm, edge, every)
    faces = np.concatenate(
        [
            np.stack([a, c, b], axis=-1)[right[:-1] & below[:, :-1]],
            np.stack([b, c, d], axis=-1)[right[1:] & below[:, 1:]],
        ]
    )
    flat = grid.reshape(-1, 3)
    corners = flat[faces]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    view = camera.centre - corners.mean(axis=1)
    size = np.linalg.norm(turned, axis=1) * np.linalg.norm(view, axis=1)
    faces = faces[np.einsum("ij,ij->i", turned, view) > _EDGE_ON * np.maximum(size, 1e-12)]
    if not len(faces):
        raise RequestError("the height map has no two neighbouring points, so there is no mesh of it")
    used, places = np.unique(faces, return_inverse=True)
    pixels = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)[used]
    at = (pixels[:, 0], pixels[:, 1])
    normals = frames.normal[at]
    if normal is not None:
        normals = np.where(np.isfinite(normal[at]), normal[at], normals)
    return Surface(
        flat[used],
        places.reshape(-1, 3),
        normals,
        frames.tangent[at],
        pixels,
        (depth_mm.shape[0], depth_mm.shape[1]),
    )


def _links(depth_mm: Any, edge: Any, every: int) -> tuple[Any, Any]:
    """Whether the surface goes on from each vertex to the next one, to the right (row, column - 1) and below.

    It does where every pixel on the way is on the subject, and no break lies between them.
    """
    import numpy as np

    known = np.isfinite(depth_mm)
    links = []
    for bit, axis in ((1, 1), (2, 0)):
        whole = np.moveaxis(known, axis, 1)[::every]
        broken = np.zeros_like(whole) if edge is None else (np.moveaxis(edge, axis, 1)[::every] & bit) > 0
        steps = whole[:, :-1] & whole[:, 1:] & ~broken[:, :-1]
        count = (whole.shape[1] - 1) // every
        links.append(np.moveaxis(steps[:, : count * every].reshape(len(steps), count, every).all(axis=2), 1, axis))
    return links[0], links[1]


def smooth_frames(depth_mm: "NDArray[np.float64]", camera: "Pinhole", *, every: int = 1) -> Frames:
    """What a renderer has at every pixel of a mesh: the frames of its vertices, interpolated.

    The normal is that of the height map, blurred as widely as the vertices are apart. The tangent is the direction
    in the surface along which the picture's row does not change (but for the lens' distortion), as in MikkTSpace.
    """
    import cv2
    import numpy as np

    from lightstage.kernels.normals.rig_normals import surface_normals

    unit = np.nan_to_num(surface_normals(camera.points(depth_mm), np.isfinite(depth_mm)))
    sigma = max(_SMOOTH_PX, float(every))
    normal = _unit(np.stack([cv2.GaussianBlur(unit[..., i], (0, 0), sigma) for i in range(3)], axis=-1))
    rays = camera.rays
    down = np.stack([np.zeros(rays.shape[:2]), rays[..., 2], -rays[..., 1]], axis=-1) @ camera.rotation
    tangent = _unit(np.cross(normal, down))
    if every > 1:
        y, x = (np.mgrid[0 : depth_mm.shape[0], 0 : depth_mm.shape[1]] / every).astype(np.float32)
        normal, tangent = (
            _unit(
                np.stack(
                    [cv2.remap(np.ascontiguousarray(part[::every, ::every, i]), x, y, cv2.INTER_LINEAR,
                               borderMode=cv2.BORDER_REPLICATE) for i in range(3)],
                    axis=-1,
                )
            )
            for part in (normal, tangent)
        )  # fmt: skip
        tangent = _unit(tangent - np.einsum("yxi,yxi->yx", tangent, normal)[..., None] * normal)
    return Frames(normal, tangent)


def _unit(vector: "NDArray[np.float64]") -> "NDArray[np.float64]":
    """(..., xyz) unit vectors; (0, 0, 1) where there is no direction."""
    import numpy as np

    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(length > 1e-6, vector / np.maximum(length, 1e-6), np.array([0.0, 0.0, 1.0]))


def tangent_space(normal: "NDArray[np.float64]", frames: Frames) -> "NDArray[np.float64]":
    """Normals (y, x, xyz), world, in the frames of the smooth surface: right, up, out.

    (0, 0, 1), the smooth surface itself, where there is no normal or it points into the surface.
    """
    import numpy as np

    axes = np.stack([frames.tangent, np.cross(frames.normal, frames.tangent), frames.normal], axis=2)
    seen = np.einsum("yxji,yxi->yxj", axes, np.nan_to_num(normal))
    known = np.isfinite(normal).all(axis=2) & (seen[..., 2] > 0)
    return np.where(known[..., None], seen, np.array([0.0, 0.0, 1.0]))


def write_glb(
    file: Path,
    surface: Surface,
    *,
    base_colour: "NDArray[np.float64] | None" = None,
    normal_map: "NDArray[np.float64] | None" = None,
    metallic_roughness: "NDArray[np.float64] | None" = None,
    specular: "NDArray[np.float64] | None" = None,
    roughness: float = ROUGHNESS,
) -> None:
    """Write a mesh with a material as binary glTF 2.0, in metres.

    All maps lie on the picture's pixels; NaN is filled from what is nearest.

    Args:
        base_colour: (y, x, rgb) linear sRGB, 0..1; stored in sRGB's code, as glTF demands.
        normal_map: (y, x, xyz) in tangent space, see `tangent_space`; stored linear, as the next two.
        metallic_roughness: (y, x, 2) metallic and roughness, 0..1.
        specular: (y, x) strength of the reflection, 0..1: KHR_materials_specular.
        roughness: of the whole surface, where there is no map.

    Raises:
        OSError: the file cannot be written.
    """
    import numpy as np
    import trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual.material import PBRMaterial

    maps: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": roughness, "doubleSided": False}
    if base_colour is not None:
        maps["baseColorTexture"] = _colour_picture(base_colour)
    if normal_map is not None:
        maps["normalTexture"] = _picture((normal_map + 1) / 2)
    if metallic_roughness is not None:
        metal, rough = metallic_roughness[..., 0], metallic_roughness[..., 1]
        maps["metallicRoughnessTexture"] = _picture(np.stack([np.ones_like(metal), rough, metal], axis=-1))
        maps |= {"metallicFactor": 1.0, "roughnessFactor": 1.0}  # they multiply the map
    mesh = trimesh.Trimesh(
        0.001 * surface.vertices,
        surface.faces,
        vertex_normals=surface.normals,
        visual=trimesh.visual.TextureVisuals(uv=surface.uv, material=PBRMaterial(**maps)),
        # the fourth number of a tangent says that the bitangent is normal x tangent
        vertex_attributes={_TANGENT: np.insert(surface.tangents, 3, 1.0, axis=1).astype(np.float32)},
        process=False,
    )

    def specular_map(buffers: Any, tree: Any) -> None:
        if specular is None:
            return
        strength = np.repeat(np.ones_like(specular)[..., None], 4, axis=-1)
        strength[..., 3] = specular
        data = _png(_picture(strength))
        tree["images"].append({"bufferView": len(buffers), "mimeType": "image/png"})
        buffers["specular"] = data + bytes(-len(data) % 4)
        tree["textures"].append({"source": len(tree["images"]) - 1})
        extension = {"specularTexture": {"index": len(tree["textures"]) - 1}}
        tree["materials"][0]["extensions"] = {_SPECULAR: extension}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", ()), _SPECULAR]

    def named(tree: Any) -> None:
        # trimesh knows tangents only as an attribute of the application's own
        attributes = tree["meshes"][0]["primitives"][0]["attributes"]
        attributes["TANGENT"] = attributes.pop(_TANGENT)

    scene = trimesh.Scene({file.stem: mesh})
    data = export_glb(scene, include_normals=True, buffer_postprocessor=specular_map, tree_postprocessor=named)
    _write({file: data})


def write_mesh(
    file: Path,
    surface: Surface,
    *,
    base_colour: "NDArray[np.float64] | None" = None,
    normal_map: "NDArray[np.float64] | None" = None,
    space: str | None = None,
) -> list[Path]:
    """Write a mesh by the file's extension; returns the files written, the mesh first.

    Args:
        base_colour: (y, x, rgb) linear sRGB, 0..1; NaN is filled from what is nearest.
        normal_map: (y, x, xyz); PLY cannot have one.
        space: of the normal map: tangent or object.

    Raises:
        OSError: a file cannot be written.
    """
    import numpy as np
    import trimesh
    from trimesh.exchange.obj import export_obj
    from trimesh.visual.material import SimpleMaterial

    form = file.suffix[1:]
    if form == "glb":
        write_glb(file, surface, base_colour=base_colour, normal_map=normal_map)
        return [file]
    colour = None if base_colour is None else _colour_picture(base_colour)
    visual: Any = None
    if colour is not None and form == "ply":
        codes = np.asarray(colour)[surface.pixels[:, 0], surface.pixels[:, 1]]
        visual = trimesh.visual.ColorVisuals(vertex_colors=codes)
    elif form == "obj" and (colour is not None or normal_map is not None):
        visual = trimesh.visual.TextureVisuals(uv=surface.uv, material=SimpleMaterial(image=colour, name=file.stem))
    mesh = trimesh.Trimesh(
        surface.vertices, surface.faces, vertex_normals=surface.normals, visual=visual, process=False
    )
    if form == "ply":
        _write({file: mesh.export(file_type="ply")})
        return [file]
    text, named = export_obj(mesh, include_normals=True, return_texture=True, mtl_name=f"{file.stem}.mtl")
    parts = {file.with_name(name): data for name, data in named.items()}
    if normal_map is not None:
        beside = file.with_name(f"{file.stem}_normal.png")
        parts[beside] = _png(_picture((normal_map + 1) / 2))
        if space == "tangent":  # MTL has no word for the other
            parts[file.with_suffix(".mtl")] += f"\nnorm {beside.name}\n".encode()
    _write({**parts, file: text.encode()})  # the mesh last, when all that it names is there
    return [file, *parts]


def _colour_picture(linear: "NDArray[np.float64]") -> "Picture":
    from lightstage.kernels.appearance.colour import encode_srgb

    return _picture(encode_srgb(filled(linear)))


def _picture(unit: "NDArray[np.float64]") -> "Picture":
    """(y, x, channel) in 0..1 as 8 bits; NaN is filled from what is nearest."""
    import numpy as np
    from PIL import Image

    return Image.fromarray(np.floor(255 * np.clip(filled(unit), 0, 1) + 0.5).astype(np.uint8))


def filled(values: "NDArray[np.float64]") -> "NDArray[np.float64]":
    """(y, x, channel) with NaN filled from the nearest pixel; 0 where all is NaN."""
    import numpy as np
    from scipy.ndimage import distance_transform_edt

    missing = ~np.isfinite(values).all(axis=-1)
    if not missing.any() or missing.all():
        return np.nan_to_num(values)
    y, x = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(values[y, x])


def _png(picture: "Picture") -> bytes:
    import io

    data = io.BytesIO()
    picture.save(data, format="png")
    return data.getvalue()


def _write(contents: "Mapping[Path, bytes]") -> None:
    """Each file appears under its name when it is whole.

    Raises:
        OSError: one cannot be written.
    """
    for target, content in contents.items():
        write_whole(target, content)


def camera_of(dataset: Any, node: str, session: "Session", store: Store) -> "Pinhole":
    """The camera that saw a node's depth; to be asked for before anything is written.

    Raises:
        RequestError: the node has no depth, or the session no camera item that fits it.
    """
    from lightstage.dag.plan import bound_items
    from lightstage.kernels.errors import KernelError
    from lightstage.kernels.surface.pinhole import Pinhole

    if "depth_mm" not in dataset:
        raise RequestError(
            f"node '{node}' has no depth, so there is no mesh of it; `lightstage export shape` has one"
        )
    items = bound_items(session, store, {})
    if "camera" not in items:
        raise RequestError(f"session '{session.name}' has no camera item, which places points in millimetres")
    try:
        return Pinhole.of(items["camera"].values, (dataset.sizes["y"], dataset.sizes["x"]))
    except KernelError as error:
        raise RequestError(f"session '{session.name}': {error}") from None


def map_space(form: str, asked: str | None) -> str | None:
    """The space of a format's normal map: what was asked for, or tangent in GLB; None: no map.

    Raises:
        RequestError: the format cannot carry it.
    """
    if asked is not None and form == "ply":
        raise RequestError(f"--normal-map {asked}: PLY has no textures; choose --format obj or glb")
    if asked == "object" and form == "glb":
        raise RequestError("--normal-map object: glTF knows tangent space alone; choose --format obj, or tangent")
    return asked or ("tangent" if form == "glb" else None)


def export_meshes(
    dataset: Any,
    camera: "Pinhole",
    node: str,
    session: "Session",
    to: Path,
    screen: Screen,
    store: Store,
    *,
    form: str,
    every: int,
    space: str | None,
) -> Mapping[str, Any]:
    """One mesh per tracking frame of a node that has depth; returns what `export` answers."""
    import numpy as np

    from lightstage.dag.plan import bound_items

    items = bound_items(session, store, {})
    files: list[str] = []
    frames = [int(t) for t in dataset.tracking.values]
    for k, frame in enumerate(screen.progress(frames, len(frames), "meshes")):
        depth = dataset.depth_mm.values[k].astype(np.float64)
        measured = _at(session, store, ("relief", "normals"), "normal", frame)
        normal = normal_map = None
        if measured is not None and measured.shape[-2:] == depth.shape:
            normal = np.moveaxis(measured[0], 0, 2).astype(np.float64)
        if normal is not None and space is not None:
            smooth = smooth_frames(depth, camera, every=every)
            normal_map = tangent_space(normal, smooth) if space == "tangent" else normal
        surface = surface_of(
            depth,
            camera,
            every=every,
            edge=dataset["edge"].values[k] if "edge" in dataset else None,
            normal=normal if normal_map is None else None,
        )
        made = write_mesh(
            to / f"{node}_tracking{frame:04d}.{form}",
            surface,
            base_colour=_colour(session, store, items, frame),
            normal_map=normal_map,
            space=space,
        )
        files += map(str, made)
    unit_name = "metres" if form == "glb" else "millimetres"
    screen.say(f"{len(frames)} meshes of {node} ({session.name}) in {to}, in {unit_name}")
    return {"files": files, "format": form, "unit": unit_name, "normal_map": space}


def _at(session: "Session", store: Store, nodes: Sequence[str], array: str, frame: int) -> Any:
    """The array of the first of these nodes that has a result with it, at a tracking frame; None without."""
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current

    for node in nodes:
        folder = current(session.name, node, store)
        if folder is None:
            continue
        dataset = open_dataset(store.results / session.name / node / folder)
        if array in dataset and frame in dataset.tracking.values:
            return dataset[array].sel(tracking=frame).values
    return None


def _colour(session: "Session", store: Store, items: Mapping[str, Any], frame: int) -> Any:
    """Albedo as linear sRGB (y, x, rgb), NaN where it is not known; None where no node has one."""
    import numpy as np

    from lightstage.kernels.appearance.colour import linear_srgb_matrix

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
    return np.einsum("cb,byx->yxc", matrix, albedo.astype(np.float64))


def _bands(items: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    return items["bands"].values["bands"] if "bands" in items else ()
