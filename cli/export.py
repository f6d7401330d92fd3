"""export: a node's pictures as PNG, EXR or NPY, for tools that do not read zarr; its normals as a film, its depth
as meshes.

Normals are exported as maps. The convention says where green points: OpenGL up, DirectX down. 8 bits are for
looking; EXR holds float channels, with convention, frame and units in its header.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli import film, mesh
from lightstage.cli.show import Screen
from lightstage.cli.values import number, whole
from lightstage.formats.exr import DATA, write_exr
from lightstage.formats.png import encode_png
from lightstage.formats.whole_file import whole_file
from lightstage.store.errors import RequestError
from lightstage.store.root import Store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

FORMATS = ("png8", "png16", "exr", "npy")
CONVENTIONS = {"opengl": "green = up (OpenGL)", "directx": "green = down (DirectX)"}
FRAME = "world: right-handed, x right, y up, z towards the camera"


def configure(commands: Any) -> None:
    """Add the commands of this file."""
    export = commands.add_parser(
        "export", help="write a node's pictures as PNG, EXR or NPY, a film of its normals, or its shape as a mesh"
    )
    export.add_argument("node", metavar="NODE")
    export.add_argument("--session", required=True, metavar="S")
    export.add_argument("--to", required=True, type=Path, metavar="DIR")
    export.add_argument("--format", required=True, choices=(*FORMATS, *film.FORMATS, *mesh.FORMATS))
    export.add_argument("--convention", choices=tuple(CONVENTIONS), default="opengl", help="where green points")
    export.add_argument(
        "--fps",
        type=number,
        metavar="N",
        help=f"frames a second of a film (default: the session's rate / {film.SLOWER}, so that one sees what "
        f"happens, and at least {film.SLOWEST_FPS:g})",
    )
    export.add_argument(
        "--pipeline", type=Path, metavar="FILE", help="default: ./pipeline.yaml, or the packaged one"
    )
    export.add_argument(
        "--every", type=whole, metavar="N", help="a mesh's vertices are every Nth pixel (default: 1)"
    )
    export.add_argument(
        "--normal-map", choices=mesh.SPACES, help="of a mesh: tangent (the default for glb) or object space (obj)"
    )
    export.set_defaults(handler=handle_export)


@dataclass(frozen=True)
class Plane:
    """One picture of a result."""

    name: str
    """File name without extension: array, and the labels of everything that is not in the picture."""
    kind: str
    """normal, mask or scalar."""
    values: "NDArray[np.generic]"
    """(y, x, xyz) for normals, (y, x) otherwise."""
    attrs: dict[str, Any]
    full_scale: float
    """What white is in the integer formats: the array's 99.9th percentile, the same for all its pictures."""


def handle_export(options: argparse.Namespace, screen: Screen) -> int:
    """lightstage export."""
    from lightstage.cli.look import brings_in
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current_path
    from lightstage.store.sessions import raw_group, read_session

    if options.fps is not None and options.format not in film.FILMS:
        raise RequestError(f"--fps {options.fps:g}: only a film has it; choose --format {' or '.join(film.FILMS)}")
    meshes = options.format in mesh.FORMATS
    if options.every is not None and (options.every < 1 or not meshes):
        raise RequestError(
            f"--every {options.every}: a step of 1 or more for a mesh (--format {', '.join(mesh.FORMATS)})"
        )
    if options.normal_map is not None and not meshes:
        raise RequestError(f"--normal-map {options.normal_map}: only a mesh has it; choose --format obj or glb")
    space = mesh.map_space(options.format, options.normal_map) if meshes else None
    store = Store(options.store, create=False)
    session = read_session(options.session, store)
    if brings_in(session.name, options.node, store, options.pipeline):
        path = raw_group(session, store)
    else:
        path = current_path(session.name, options.node, store)
    dataset = open_dataset(path)
    camera = mesh.camera_of(dataset, options.node, session, store) if meshes else None
    try:
        options.to.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RequestError(f"--to {options.to}: no folder can be made there ({error.strerror})") from None
    if options.format in film.FORMATS:
        answer = film.export_film(
            dataset,
            options.node,
            session,
            options.to,
            screen,
            form=options.format,
            convention=options.convention,
            fps=options.fps,
        )
        if options.format in film.FILMS:
            for file in answer["files"]:
                screen.say(f"film: {file}")
        screen.document(answer)
        return 0
    if camera is not None:
        screen.document(
            mesh.export_meshes(
                dataset,
                camera,
                options.node,
                session,
                options.to,
                screen,
                store,
                form=options.format,
                every=options.every or 1,
                space=space,
            )
        )
        return 0
    written = []
    count = sum(
        int(a.size // (a.sizes["y"] * a.sizes["x"] * a.sizes.get("xyz", 1))) for a in dataset.data_vars.values()
    )
    for plane in screen.progress(planes(dataset), count, "pictures"):
        header = {
            **{k: v for k, v in dataset.attrs.items() if isinstance(v, str | int | float)},
            **plane.attrs,
        }
        file = options.to / f"{plane.name}.{options.format.rstrip('0123456789')}"
        _write(file, plane, options.format, options.convention, header)
        written.append(str(file))
    screen.say(f"{len(written)} pictures of {options.node} ({session.name}) in {options.to}")
    screen.document({"files": written, "convention": options.convention, "format": options.format})
    return 0


def planes(dataset: Any) -> Iterator[Plane]:
    """Every picture of a dataset."""
    import itertools

    import numpy as np

    for name, array in dataset.data_vars.items():
        inner = [dim for dim in ("xyz", "y", "x") if dim in array.dims]
        outer = [dim for dim in array.dims if dim not in inner]
        normal = "xyz" in inner
        kind = "normal" if normal else "mask" if array.dtype == bool else "scalar"
        scale = 1.0
        if kind == "scalar":
            sample = array.values[..., ::4, ::4].astype(np.float32)
            sample = sample[np.isfinite(sample)]
            top = float(np.percentile(sample, 99.9)) if sample.size else 1.0
            scale = top if top > 0 else 1.0
        for index in itertools.product(*(range(array.sizes[dim]) for dim in outer)):
            here = array.isel(dict(zip(outer, index, strict=True)))
            labels = [_label(dataset, dim, i) for dim, i in zip(outer, index, strict=True)]
            if normal:
                values = here.transpose("y", "x", "xyz").values.astype(np.float32)
            else:
                values = here.transpose("y", "x").values
            yield Plane(
                "_".join([str(name), *labels]), kind, values, {"units": array.attrs.get("units", "")}, scale
            )


def _label(dataset: Any, dim: str, index: int) -> str:
    if dim == "frame" and "illumination" in dataset.coords:
        return f"{index:04d}_{dataset.coords['illumination'].values[index]}"
    if dim in dataset.coords:
        value = dataset.coords[dim].values[index]
        if dim == "band":
            return f"{value:g}nm" if value else "broadband"
        return f"{dim}{value:04d}" if dim == "tracking" else str(value)
    return f"{dim}{index}"


def _write(file: Path, plane: Plane, form: str, convention: str, header: dict[str, Any]) -> None:
    import numpy as np

    values = np.asarray(plane.values)
    if plane.kind == "normal" and convention == "directx":
        values = values * np.array([1, -1, 1], values.dtype)
    header = {
        **header,
        "frame": FRAME,
        "convention": CONVENTIONS[convention] if plane.kind == "normal" else "linear",
    }
    with whole_file(file) as beside:
        if form == "npy":
            np.save(beside, values)
        elif form == "exr":
            said = {name: str(value) for name, value in header.items() if value != ""}
            write_exr(beside, _channels(plane.kind, values), colour=DATA, **said)
        else:
            beside.write_bytes(encode_png(_counts(plane, values, 65535 if form == "png16" else 255)))


def _counts(plane: Plane, values: Any, top: int) -> Any:
    """Normals as (n + 1) / 2, scalars from 0 to the array's full scale; black where not valid."""
    import numpy as np

    dtype = np.uint16 if top > 255 else np.uint8
    if plane.kind == "normal":
        unit = (values + 1) / 2
    elif plane.kind == "mask":
        unit = values.astype(np.float32)
    else:
        unit = values / plane.full_scale
    return np.nan_to_num(np.round(np.clip(unit, 0, 1) * top), nan=0.0).astype(dtype)


def _channels(kind: str, values: Any) -> dict[str, Any]:
    """Channels of an EXR: normal.X, normal.Y, normal.Z, or Y; NaN where not valid."""
    if kind == "normal":
        return {f"normal.{axis}": values[..., i] for i, axis in enumerate("XYZ")}
    return {"Y": values}
