"""The names of delivered files; scripts depend on them (docs/formats.md).

Light to import: a command asks for names before it computes.
"""

from collections.abc import Sequence

from lightstage.formats import meshes

MATERIAL_RECORD = "material.json"
RELIGHT_RECORD, RELIGHT_TABLE, RELIGHT_SHEET = "relight.json", "relight.csv", "relight.png"
RELIGHT_FILM = "environment_turn.mp4"
EXPORT_RECORD = "export.json"
BASE_COLOUR, BANDS, NORMAL_DIFFUSE, DEPTH, MASK = (
    "base_colour.exr", "bands.exr", "normal_diffuse.exr", "depth.exr", "mask.exr",
)  # fmt: skip
SPECULAR, ROUGHNESS, NORMAL_SPECULAR = "specular.exr", "roughness.exr", "normal_specular.exr"
MATERIAL_MESH = "material.glb"


def band(nm: float) -> str:
    """Of a band; 0 is unfiltered light."""
    return f"{nm:g}nm" if nm else "broadband"


def tracking(frame: int) -> str:
    """Of a tracking frame."""
    return f"tracking{frame:04d}"


def frame(number: int, illumination: str | None = None) -> str:
    """Of a frame of a session."""
    return f"{number:04d}" + (f"_{illumination}" if illumination is not None else "")


def plane(array: str, labels: Sequence[str]) -> str:
    """Of a picture of a result, without extension: array, and the labels of what is not in the picture."""
    return "_".join([array, *labels])


def contact_sheet(session: str) -> str:
    """Of a session's contact sheet."""
    return f"{session}.png"


def film(session: str, node: str, nm: float | None = None) -> str:
    """Of the film of a node's normals, without extension; `nm` where the node has several bands."""
    return f"{session}_{node}" + (f"_{nm:g}nm" if nm is not None else "")


def alignment(session: str, tracking_frame: int) -> str:
    """Of the page that shows the alignment of a tracking frame."""
    return f"{session}_alignment_{tracking_frame}.png"


def skin(session: str) -> dict[str, str]:
    """Of the pigment maps, the spectra and their table."""
    stem = f"{session}_skin"
    return {"picture": f"{stem}.png", "spectra": f"{stem}_spectra.png", "table": f"{stem}_spectra.csv"}


def shape_folder(session: str) -> str:
    """Of the folder that `shape` writes where none is named."""
    return f"{session}_shape"


def mesh(node: str, tracking_frame: int) -> str:
    """Of the mesh of a tracking frame, without extension."""
    return f"{node}_{tracking(tracking_frame)}"


def mesh_files(node: str, tracking_frame: int, form: str) -> tuple[str, ...]:
    """What the mesh of a tracking frame may consist of."""
    return meshes.names_of(mesh(node, tracking_frame), form)


def material(formats: Sequence[str], *, glossy: bool) -> list[str]:
    """Of the maps and the mesh of a material, by the formats asked for."""
    names = []
    if "exr" in formats:
        names = [BASE_COLOUR, BANDS, NORMAL_DIFFUSE, DEPTH, MASK]
        names += [SPECULAR, ROUGHNESS, NORMAL_SPECULAR] if glossy else []
    return [*names, *([MATERIAL_MESH] if "glb" in formats else [])]


def relit(pictures: Sequence[str], *, turns: bool) -> list[str]:
    """Of pictures under other lights, their table and sheet, and the film of an environment that turns."""
    return [
        *(f"{picture}.{form}" for picture in pictures for form in ("png", "exr")),
        *(RELIGHT_TABLE, RELIGHT_SHEET),
        *([RELIGHT_FILM] if turns else []),
    ]


def stimulus(subject: str, kind: str) -> tuple[str, str]:
    """Of a picture of a set: with 8 and with 16 bits."""
    return f"{subject}_{kind}.png", f"16bit/{subject}_{kind}.png"


def morph(first: str, second: str, vary: str, level: float) -> str:
    """Of a face between two, as a subject; levels are told apart to a hundredth."""
    return f"{first}-{second}-{vary}-{round(100 * level):03d}"


def light_preview(session: str) -> str:
    """Of the sheet of a shape under single lights."""
    return f"{session}-lights.png"
