"""Meshes as PLY, OBJ and GLB, through trimesh.

PLY and OBJ are in the mesh's millimetres, GLB in metres, because glTF demands it. PLY has its colours at the
vertices, the others have pictures. A normal map is in *tangent* space (green up: relative to the vertices' normals
and tangents) or in *object* space, the mesh's own axes; glTF knows the former alone, and PLY none.
"""

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lightstage.formats.errors import FormatError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

FORMATS = ("ply", "obj", "glb")
SPACES = ("tangent", "object")
_MM = 0.001
"""In metres."""
_TANGENT = "_TANGENT"
_SPECULAR = "KHR_materials_specular"


@dataclass(frozen=True)
class Mesh:
    """Triangles with what they are painted by."""

    vertices: "NDArray[np.float64]"
    """(vertex, xyz), mm."""
    faces: "NDArray[np.int64]"
    """(face, 3), counter-clockwise from outside."""
    normals: "NDArray[np.float64]"
    """(vertex, xyz), unit vectors."""
    tangents: "NDArray[np.float64]"
    """(vertex, xyz), unit vectors to the right in the pictures, across `normals`."""
    uv: "NDArray[np.float64]"
    """(vertex, 2): texture coordinates, the origin at the lower left."""


@dataclass(frozen=True)
class Textures:
    """Pictures of 8 bits, (y, x, channel) or (y, x); None where there is none."""

    base_colour: "NDArray[np.uint8] | None" = None
    """RGB in sRGB's code."""
    normal: "NDArray[np.uint8] | None" = None
    """(n + 1) / 2, linear, as the next two."""
    metallic_roughness: "NDArray[np.uint8] | None" = None
    """Roughness in green, metallic in blue."""
    specular: "NDArray[np.uint8] | None" = None
    """RGBA, the strength of the reflection in A: KHR_materials_specular."""


def mesh_files(
    name: str,
    form: str,
    mesh: Mesh,
    textures: Textures,
    *,
    colours: "NDArray[np.uint8] | None" = None,
    space: str | None = None,
    roughness: float = 1.0,
) -> dict[str, bytes]:
    """A mesh in a format: its files by name, the mesh last, when all that it names is there.

    Args:
        name: of the files, without extension.
        form: one of FORMATS.
        mesh, textures: see there.
        colours: (vertex, rgb) in sRGB's code, for PLY.
        space: of the normal map, for OBJ: one of SPACES.
        roughness: of the whole surface where there is no map, for GLB.
    """
    if form == "glb":
        return {f"{name}.glb": _glb(name, mesh, textures, roughness)}
    if form == "ply":
        return {f"{name}.ply": _ply(mesh, colours)}
    return _obj(name, mesh, textures, space)


def names_of(name: str, form: str) -> tuple[str, ...]:
    """The files that `mesh_files` can make, the mesh first."""
    return (
        (f"{name}.obj", f"{name}.mtl", f"{name}.png", f"{name}_normal.png")
        if form == "obj"
        else (f"{name}.{form}",)
    )


def normal_map_space(form: str, choice: str | None) -> str | None:
    """The space of a format's normal map: what was chosen, or tangent in GLB; None: no map.

    Raises:
        FormatError: the format cannot carry it.
    """
    if choice is not None and form == "ply":
        raise FormatError(f"a normal map in {choice} space: PLY has no textures; choose obj or glb")
    if choice == "object" and form == "glb":
        raise FormatError("a normal map in object space: glTF knows tangent space alone; choose obj, or tangent")
    return choice or ("tangent" if form == "glb" else None)


def _glb(name: str, mesh: Mesh, textures: Textures, roughness: float) -> bytes:
    """Binary glTF 2.0 with a PBR material."""
    import numpy as np
    import trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual.material import PBRMaterial

    maps: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": roughness, "doubleSided": False}
    if textures.base_colour is not None:
        maps["baseColorTexture"] = _picture(textures.base_colour)
    if textures.normal is not None:
        maps["normalTexture"] = _picture(textures.normal)
    if textures.metallic_roughness is not None:
        maps["metallicRoughnessTexture"] = _picture(textures.metallic_roughness)
        maps |= {"metallicFactor": 1.0, "roughnessFactor": 1.0}  # they multiply the map
    body = trimesh.Trimesh(
        _MM * mesh.vertices,
        mesh.faces,
        vertex_normals=mesh.normals,
        visual=trimesh.visual.TextureVisuals(uv=mesh.uv, material=PBRMaterial(**maps)),
        # the fourth number of a tangent says that the bitangent is normal x tangent
        vertex_attributes={_TANGENT: np.insert(mesh.tangents, 3, 1.0, axis=1).astype(np.float32)},
        process=False,
    )

    def add_specular(buffers: Any, tree: Any) -> None:
        if textures.specular is None:
            return
        data = _png(textures.specular)
        tree["images"].append({"bufferView": len(buffers), "mimeType": "image/png"})
        buffers["specular"] = data + bytes(-len(data) % 4)
        tree["textures"].append({"source": len(tree["images"]) - 1})
        extension = {"specularTexture": {"index": len(tree["textures"]) - 1}}
        tree["materials"][0]["extensions"] = {_SPECULAR: extension}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", ()), _SPECULAR]

    def rename_tangents(tree: Any) -> None:
        # trimesh knows tangents only as an attribute of the application's own
        attributes = tree["meshes"][0]["primitives"][0]["attributes"]
        attributes["TANGENT"] = attributes.pop(_TANGENT)

    data: bytes = export_glb(
        trimesh.Scene({name: body}),
        include_normals=True,
        buffer_postprocessor=add_specular,
        tree_postprocessor=rename_tangents,
    )
    return data


def _ply(mesh: Mesh, colours: "NDArray[np.uint8] | None") -> bytes:
    """Binary PLY, which has no use for tangents and texture coordinates."""
    import trimesh

    visual = None if colours is None else trimesh.visual.ColorVisuals(vertex_colors=colours)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, visual=visual, process=False)
    data: bytes = body.export(file_type="ply")
    return data


def _obj(name: str, mesh: Mesh, textures: Textures, space: str | None) -> dict[str, bytes]:
    """OBJ with its MTL and PNGs."""
    import trimesh
    from trimesh.exchange.obj import export_obj
    from trimesh.visual.material import SimpleMaterial

    visual: Any = None
    if textures.base_colour is not None or textures.normal is not None:
        colour = None if textures.base_colour is None else _picture(textures.base_colour)
        visual = trimesh.visual.TextureVisuals(uv=mesh.uv, material=SimpleMaterial(image=colour, name=name))
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, visual=visual, process=False)
    text, files = export_obj(body, include_normals=True, return_texture=True, mtl_name=f"{name}.mtl")
    files = dict(files)
    if textures.normal is not None:
        beside = f"{name}_normal.png"
        files[beside] = _png(textures.normal)
        if space == "tangent":  # MTL has no word for the other
            files[f"{name}.mtl"] += f"\nnorm {beside}\n".encode()
    return {**files, f"{name}.obj": text.encode()}


def _picture(counts: "NDArray[np.uint8]") -> Any:
    from PIL import Image

    return Image.fromarray(counts)


def _png(counts: "NDArray[np.uint8]") -> bytes:
    data = io.BytesIO()
    _picture(counts).save(data, format="png")
    return data.getvalue()
