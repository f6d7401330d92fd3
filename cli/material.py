"""material: what a renderer needs of a subject, as EXR maps and as a GLB with a glTF PBR material.

Base colour is the diffuse albedo of all bands, seen in colour (`kernels/appearance/colour.py`); it lies beside
the bands themselves. Maps are padded beyond the subject with what is nearest, so that filtering brings in no
background; the mask says where the subject is.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.deliver import Delivery
from lightstage.cli.run import add_run_options, override_items, paths_of, run_session, session_of
from lightstage.cli.show import Screen
from lightstage.cli.values import whole
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lightstage.kernels.surface.pinhole import Pinhole

FORMATS = ("exr", "glb")
RECORD = "material.json"
FORMAT = "lightstage-material/1"
FRAME = "world: right-handed, x right, y up, z towards the camera"
GLTF_NORMAL_INCIDENCE = 0.04
_NODES = ("reflectance", "relief", "shape")
_GLOSS = ("specular", "gloss")


def configure(commands: Any) -> None:
    """Add the command of this file."""
    material = commands.add_parser(
        "material", help="base colour, gloss, normals and depth for renderers, as EXR and GLB (glTF PBR)"
    )
    material.add_argument("session", nargs="?", metavar="SESSION|FOLDER", help="default: the virtual rig's demo")
    material.add_argument("--to", required=True, type=Path, metavar="DIR")
    material.add_argument(
        "--format", default="exr,glb", metavar="exr,glb", help="one or both, with a comma (default: both)"
    )
    material.add_argument("--tracking", type=whole, metavar="N", help="the tracking frame (default: the first)")
    add_run_options(material)
    material.set_defaults(handler=handle_material, computes=True)


@dataclass(frozen=True)
class Material:
    """One tracking frame of a subject, measured. Maps are (y, x, ...), NaN where not known."""

    session: str
    tracking: int
    bands_nm: tuple[float, ...]
    widths_nm: tuple[float | None, ...]
    reflectance: "NDArray[np.float64]"
    """(band, y, x)."""
    absolute: bool
    """Whether 1 is a perfect white; else it is the brightest point."""
    normal: "NDArray[np.float64]"
    """(y, x, xyz), of the diffuse component, world."""
    depth_mm: "NDArray[np.float64]"
    """(y, x), camera z."""
    edge: "NDArray[np.uint8]"
    camera: "Pinhole"
    gloss: "Gloss | None"
    """None where the capture lacks one of the polarisations."""
    recipes: Mapping[str, str]
    """Node to the folder of its result."""

    @property
    def known(self) -> "NDArray[np.bool_]":
        """(y, x): the subject, where it has albedo, normal and depth."""
        import numpy as np

        inside = np.isfinite(self.reflectance).all(axis=0) & np.isfinite(self.depth_mm)
        return np.asarray(inside & np.isfinite(self.normal).all(axis=2))

    @property
    def colour(self) -> "NDArray[np.float64]":
        """(y, x, rgb): linear Rec. 709 under D65, grey of one band; negative where a colour is beyond it."""
        import numpy as np

        from lightstage.kernels.appearance.colour import linear_srgb_matrix

        matrix = linear_srgb_matrix(self.bands_nm, self.widths_nm)
        return np.moveaxis(np.tensordot(matrix, self.reflectance, 1), 0, 2)


@dataclass(frozen=True)
class Gloss:
    """The specular component; maps are NaN where not known."""

    specular: "NDArray[np.float64]"
    """(y, x): reflectance at normal incidence."""
    alpha: "NDArray[np.float64]"
    """(y, x): GGX width."""
    normal: "NDArray[np.float64]"
    """(y, x, xyz), world."""
    index: float
    """Refractive, as `gloss` took it."""
    absolute: bool
    """Else the median of `specular` is set to that of the index."""


def nodes_of(session: str, store: Store) -> tuple[str, ...]:
    """What has to be run: gloss needs both polarisations."""
    from lightstage.store.sessions import read_session

    polarised = {"parallel", "cross"} <= set(read_session(session, store).polarisations)
    return (*_NODES, *_GLOSS) if polarised else _NODES


def handle_material(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage material."""
    from lightstage.cli.demo import demo_session

    formats = options.format.split(",")
    wrong = [form for form in formats if form not in FORMATS]
    if wrong:
        raise RequestError(f"--format {options.format}: '{wrong[0]}' is not known; expected exr, glb or exr,glb")
    store = Store(options.store)
    options.session = session_of(options.session, store, screen) if options.session else demo_session(store, screen)
    nodes = nodes_of(options.session, store)
    delivery = Delivery(options.to, RECORD)
    delivery.claim(_names(formats, glossy="gloss" in nodes), options.session)
    summary = run_session(options, store, screen, nodes)
    material = read_material(options, store, paths_of(summary, nodes, options.session))
    with delivery.making() as work:
        files: dict[str, dict[str, Any]] = {}
        if "exr" in formats:
            files |= _write_maps(work, material)
        if "glb" in formats:
            files |= _write_glb(work, material)
        document = {
            "format": FORMAT,
            "session": material.session,
            "tracking": material.tracking,
            "frame": FRAME,
            "scale": "absolute: 1 is a perfect white"
            if material.absolute
            else "relative: 1 is the brightest point",
            "beyond the subject": "padded with what is nearest; mask.exr is 1 on the subject",
            "results": dict(material.recipes),
        }
        made = delivery.settle(work, document, files)
    if material.gloss is None:
        screen.warn("the capture lacks one of the polarisations, so there are no specular maps and no roughness")
    if not material.absolute:
        screen.warn(
            "the scale is relative, because a lights or bands item is missing or the parallel camera alone: 1 in "
            "the base colour is the brightest point"
        )
    screen.table(("file", "what"), [(name, entry["what"]) for name, entry in files.items()])
    screen.say(f"{len(made)} files in {options.to}; {RECORD} says what each is")
    screen.document({**summary, "files": [str(file) for file in made], "material": {**document, "files": files}})
    return 0


def read_material(options: argparse.Namespace, store: Store, paths: Mapping[str, Path]) -> Material:
    """The results at `paths`, by node.

    Raises:
        RequestError: there is no such tracking frame, no camera item, or nothing is known of the subject.
    """
    import numpy as np

    from lightstage.dag.plan import bound_items
    from lightstage.kernels.surface.pinhole import Pinhole
    from lightstage.store.grid import open_dataset
    from lightstage.store.sessions import read_session

    session = read_session(options.session, store)
    opened = {node: open_dataset(path) for node, path in paths.items()}
    have = [int(frame) for frame in opened["shape"]["tracking"].values]
    frame = have[0] if options.tracking is None and have else options.tracking
    for node, dataset in opened.items():
        if frame not in dataset["tracking"].values:
            listed = ", ".join(str(t) for t in dataset["tracking"].values) or "none"
            raise RequestError(
                f"'{node}' of session '{session.name}' has no tracking frame {frame}; it has {listed}"
            )
    here = {node: dataset.sel(tracking=frame) for node, dataset in opened.items()}
    items = bound_items(session, store, override_items(options.calibration, store))
    bands = tuple(float(nm) for nm in here["reflectance"]["band"].values)
    entries = items["bands"].values["bands"] if "bands" in items else ()
    widths = {float(entry["centre_nm"]): entry["width_nm"] for entry in entries}

    def picture(node: str, name: str) -> "NDArray[np.float64]":
        return np.asarray(here[node][name].values, np.float64)

    gloss = None
    if "gloss" in here:
        gloss = _gloss(
            picture("gloss", "specular"),
            picture("gloss", "roughness"),
            np.moveaxis(picture("specular", "normal")[0], 0, 2),
            np.isfinite(picture("shape", "depth_mm")),
            opened["gloss"].attrs,
        )
    depth = picture("shape", "depth_mm")
    material = Material(
        session.name,
        frame,
        bands,
        tuple(widths.get(nm) for nm in bands),
        picture("reflectance", "reflectance"),
        opened["reflectance"].attrs["scale"] == "absolute",
        np.moveaxis(picture("relief", "normal")[0], 0, 2),
        depth,
        np.asarray(here["shape"]["edge"].values),
        Pinhole.of(items["camera"].values, (depth.shape[0], depth.shape[1])),
        gloss,
        {node: path.name for node, path in paths.items()},
    )
    if not material.known.any():
        raise RequestError(f"session '{session.name}' has no pixel with albedo, normal and depth")
    return material


def _gloss(specular: Any, alpha: Any, normal: Any, known: Any, attrs: Mapping[str, Any]) -> Gloss:
    import numpy as np

    from lightstage.kernels.appearance.microfacets import at_normal_incidence

    index, absolute = float(attrs["index"]), attrs["scale"] == "absolute"
    if not absolute:
        # of the subject: a background that shines nowhere has a number too
        specular = specular * (at_normal_incidence(index) / np.nanmedian(specular[known]))
    return Gloss(specular, alpha, normal, index, absolute)


def _names(formats: "list[str]", *, glossy: bool) -> "list[str]":
    """The files that formats make."""
    names = []
    if "exr" in formats:
        names = ["base_colour.exr", "bands.exr", "normal_diffuse.exr", "depth.exr", "mask.exr"]
        names += ["specular.exr", "roughness.exr", "normal_specular.exr"] if glossy else []
    return [*names, *(["material.glb"] if "glb" in formats else [])]


def _write_maps(work: Path, material: Material) -> dict[str, dict[str, Any]]:
    """The EXR files; returns what each is."""
    import numpy as np

    from lightstage.cli.mesh import filled
    from lightstage.formats.exr import COLOUR, DATA, REC709, rgb, spectral, write_exr

    known, gloss = material.known, material.gloss
    files: dict[str, dict[str, Any]] = {}

    def padded(values: "NDArray[np.float64]") -> "NDArray[np.float64]":
        """(y, x) or (y, x, channel), from what is nearest on the subject."""
        layers = values[..., None] if values.ndim == 2 else values
        made = filled(np.where(known[..., None], layers, np.nan))
        return np.asarray(made[..., 0] if values.ndim == 2 else made)

    def write(name: str, channels: Mapping[str, Any], what: str, units: str, **more: Any) -> None:
        colour = more.pop("colour", DATA)
        write_exr(work / name, channels, colour=colour, units=units, session=material.session, **more)
        files[name] = {"what": what, "channels": list(channels), "units": units, "colorInteropID": colour, **more}

    def unit(normal: "NDArray[np.float64]") -> "NDArray[np.float64]":
        made = padded(normal)
        return np.asarray(made / np.maximum(np.linalg.norm(made, axis=2, keepdims=True), 1e-9))

    bands = np.moveaxis(padded(np.moveaxis(material.reflectance, 0, 2)), 2, 0)
    write("base_colour.exr", rgb(padded(material.colour)), "diffuse albedo in colour", "1", colour=COLOUR)
    files["base_colour.exr"]["chromaticities"] = REC709
    widths = ", ".join("?" if width is None else f"{width:g}" for width in material.widths_nm)
    write(
        "bands.exr",
        spectral(bands, material.bands_nm),
        "diffuse albedo in each band; a channel's name is its wavelength",
        "1",
        width_nm=widths,
    )
    encoding = {"frame": FRAME, "encoding": "signed: R, G, B are x, y, z from -1 to 1"}
    write("normal_diffuse.exr", rgb(unit(material.normal)), "normals of the diffuse component", "1", **encoding)
    write("depth.exr", {"Z": padded(material.depth_mm)}, "camera z of the surface", "mm")
    write("mask.exr", {"Y": known.astype(np.float64)}, "1 on the subject, 0 where maps are padded", "1")
    if gloss is not None:
        scale = "absolute" if gloss.absolute else "relative: the median is set to the index's"
        write(
            "specular.exr",
            {"Y": padded(gloss.specular)},
            "specular reflectance at normal incidence",
            "1",
            scale=scale,
            refractive_index=gloss.index,
        )
        write(
            "roughness.exr",
            {"Y": np.sqrt(padded(gloss.alpha))},
            "roughness of renderers: the square root of the GGX width",
            "1",
        )
        write("normal_specular.exr", rgb(unit(gloss.normal)), "normals of the specular component", "1", **encoding)
    return files


def _write_glb(work: Path, material: Material) -> dict[str, dict[str, Any]]:
    """The mesh with its material; returns what it is."""
    import numpy as np

    from lightstage.cli.mesh import ROUGHNESS, smooth_frames, surface_of, tangent_space, write_glb

    known, gloss = material.known, material.gloss
    base = np.where(known[..., None], material.colour, np.nan)
    frames = smooth_frames(material.depth_mm, material.camera)
    rough = factor = None
    entry: dict[str, Any] = {
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
    write_glb(
        work / "material.glb",
        surface_of(material.depth_mm, material.camera, edge=material.edge),
        base_colour=base,
        normal_map=tangent_space(material.normal, frames),
        metallic_roughness=rough,
        specular=factor,
    )
    return {"material.glb": entry}


def _share(where: "NDArray[np.bool_]", known: "NDArray[np.bool_]") -> float:
    """Of the subject's pixels, rounded."""
    return round(float(where[known].mean()), 5)
