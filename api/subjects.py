"""What products are made of: the results of an answer and the items of its request, read for one product each."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.items import item_values
from lightstage.api.refusals import refusals
from lightstage.api.requests import Request
from lightstage.dag.answer import Answer
from lightstage.store.digest import SHORT, digest_value
from lightstage.store.errors import RequestError
from lightstage.store.grid import open_dataset
from lightstage.store.root import Store
from lightstage.store.sessions import Session

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from numpy.typing import NDArray

    from lightstage.products.light_setups import Setup
    from lightstage.products.material import Material
    from lightstage.products.skin import Pigments, Skin

SKIN_NODES = ("reflectance", "chromophores")


def paths_of(answer: Answer, nodes: Sequence[str]) -> dict[str, Path]:
    """Where the results of an answer are: those of this run, and no others.

    Raises:
        RequestError: its frames have left a node nothing.
    """
    paths = {node: answer.nodes[node].path for node in nodes}
    present = {node: path for node, path in paths.items() if path is not None}
    if len(present) < len(paths):
        raise RequestError(f"session '{answer.session}': --frames leaves no tracking frame to work on")
    return present


def opened(answer: Answer, nodes: Sequence[str]) -> "dict[str, xarray.Dataset]":
    """The same, opened and checked."""
    return {node: open_dataset(path) for node, path in paths_of(answer, nodes).items()}


def skin_of(answer: Answer, request: Request, store: Store, *, tracking: int | None = None) -> "Skin":
    """The pigments of a subject, of `SKIN_NODES`.

    Raises:
        RequestError: there is no such tracking frame.
    """
    from lightstage.products.skin import read_skin

    results = opened(answer, SKIN_NODES)
    bands = item_values(request, store)["bands"]["bands"]
    with refusals():
        return read_skin(
            results["reflectance"],
            results["chromophores"],
            bands,
            _pigments(results["chromophores"].attrs["parameters"]),
            session=request.session,
            tracking=tracking,
        )


def _pigments(parameters: Mapping[str, Any]) -> "Pigments":
    """The stage's fit with a result's parameters."""
    from lightstage.kernels.appearance.chromophores import chromophores, predicted
    from lightstage.stages.chromophores import ChromophoresParams

    params = ChromophoresParams(**parameters)
    skin = {name: getattr(params, name) for name in ("model", "saturation", "vessel_radius_um")}

    class Fit:
        model, saturation, vessel_radius_um = params.model, params.saturation, params.vessel_radius_um
        pass_band = params.pass_band

        def fit(self, reflectance: Any, standard_error: Any, passing: Any) -> Mapping[str, Any]:
            settings = params.model_dump(exclude={"pass_band"})
            return chromophores(reflectance, standard_error, passing=passing, **settings)

        def predicted(self, melanin: Any, haemoglobin: Any, baseline: Any, passing: Any) -> Any:
            return predicted(melanin, haemoglobin, baseline, passing=passing, **skin)

    return Fit()


def material_nodes(session: Session) -> tuple[str, ...]:
    """What a material is made of: gloss needs both polarisations."""
    from lightstage.products.material import GLOSS_NODES, NODES

    polarised = {"parallel", "cross"} <= set(session.polarisations)
    return (*NODES, *GLOSS_NODES) if polarised else NODES


def material_of(
    answer: Answer, request: Request, session: Session, store: Store, *, tracking: int | None = None
) -> "Material":
    """What a renderer needs of a subject, of `material_nodes`.

    Raises:
        RequestError: there is no such tracking frame, or nothing is known of the subject.
    """
    from lightstage.products.material import read_material

    paths = paths_of(answer, material_nodes(session))
    items = item_values(request, store)
    with refusals():
        return read_material(
            {node: open_dataset(path) for node, path in paths.items()},
            {node: path.name for node, path in paths.items()},
            items["camera"],
            items["bands"]["bands"] if "bands" in items else (),
            session=session.name,
            tracking=tracking,
        )


def own_lights(names: Sequence[str], request: Request, store: Store) -> "list[Setup]":
    """The rig's own lights as those of pictures.

    Raises:
        RequestError: the session has no lights item, or no light of that name.
    """
    if not names:
        return []
    from lightstage.products.light_setups import led_pictures

    items = item_values(request, store)
    if "lights" not in items:
        raise RequestError(
            f"session '{request.session}' has no lights item, which says where the rig's lights are; "
            "--light and --environment do without"
        )
    with refusals("--led "):
        return led_pictures(names, items["lights"])


def environment(path: Path) -> "NDArray[np.float32]":
    """A map of an environment's light, (y, x, rgb).

    Raises:
        RequestError: there is no such file, or it is no environment.
    """
    from lightstage.formats.environment import read_environment
    from lightstage.store.intake import FileError, open_regular

    try:
        with open_regular(path):
            pass  # OpenImageIO opens it by its name
    except FileError as error:
        raise RequestError(
            f"--environment {path} {error}; give a .hdr or .exr map in latitude and longitude"
        ) from None
    with refusals("--environment "):
        return read_environment(path)


def recipe_digest(recipe: Mapping[str, Any]) -> str:
    """What names a set that was made by a recipe."""
    return digest_value(recipe)[:SHORT]


def face_of(answer: Answer, node: str, above: str) -> "tuple[xarray.Dataset, xarray.Dataset, str]":
    """The pictures of a stimulus node, the normals that they were made from, and the result's folder.

    Raises:
        RequestError: the request's frames have left nothing.
    """
    paths = [answer.nodes[name].path for name in (node, above)]
    if paths[0] is None or paths[1] is None:
        raise RequestError(f"session '{answer.session}': --frames leaves nothing to make stimuli of")
    pictures, relief = open_dataset(paths[0]), open_dataset(paths[1])
    # not every tracking frame that has normals has a reflectance
    return pictures, relief.sel(tracking=pictures.tracking.values), paths[0].name
