"""A subject for renderers, and a subject relit, into a folder of the user's: all of it, or nothing.

A delivery is opened before anything is computed, and says then whether its files may be written; what it needs to
be computed is in `nodes`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.refusals import refusals
from lightstage.api.requests import Request
from lightstage.api.subjects import environment, material_nodes, material_of, opened, own_lights
from lightstage.dag.answer import Answer
from lightstage.products import choices, names
from lightstage.products.progress import Progress, silent
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.products.light_setups import Setup
    from lightstage.products.relit import Row
    from lightstage.store.sessions import Session


@dataclass(frozen=True)
class Delivered:
    """What lies in the folder now."""

    files: tuple[Path, ...]
    """The record is the last."""
    entries: Mapping[str, Mapping[str, Any]]
    """What each is, by name."""
    document: Mapping[str, Any]
    """What the record says of all."""
    glossy: bool
    """Whether the capture showed gloss."""
    absolute: bool
    """Whether 1 is a perfect white; else it is the brightest point."""
    rows: "tuple[Row, ...]" = ()
    """Of relit pictures, what the table says."""


class MaterialDelivery:
    """Base colour, gloss, normals and depth of a subject, as EXR maps and as a mesh."""

    def __init__(self, session: "Session", store: Store, folder: Path, formats: Sequence[str]) -> None:
        """For a folder, which need not be there yet.

        Args:
            formats: of `choices.MATERIAL_FORMATS`.

        Raises:
            RequestError: there can be no such folder, or a file of the same name is not this command's.
        """
        from lightstage.formats.whole_set import WholeSet

        self.nodes = material_nodes(session)
        self._session, self._store, self._folder, self._formats = session, store, folder, formats
        self._set = WholeSet(folder, names.MATERIAL_RECORD, subject={"session": session.name})
        with refusals():
            self._set.claim(names.material(formats, glossy="gloss" in self.nodes))

    def deliver(self, request: Request, answer: Answer, *, tracking: int | None = None) -> Delivered:
        """Write the files, of an answer to `nodes`.

        Raises:
            RequestError: there is no such tracking frame, or nothing is known of the subject.
            OSError: a file cannot be written.
        """
        from lightstage.products.material import document, write_material

        material = material_of(answer, request, self._session, self._store, tracking=tracking)
        with refusals(), self._set.making() as work:
            entries = write_material(work, material, self._formats)
            recorded = {name: {**entry, "results": dict(material.recipes)} for name, entry in entries.items()}
            files = self._set.settle(work, document(material), recorded)
        return Delivered(
            files=(*files, self._folder / names.MATERIAL_RECORD),
            entries=entries,
            document=document(material),
            glossy=material.gloss is not None,
            absolute=material.absolute,
        )


class RelightDelivery:
    """Pictures of a subject under other lights, their table and sheet; and an environment that turns, as a film."""

    def __init__(
        self,
        session: "Session",
        store: Store,
        folder: Path,
        request: Request,
        setups: "Sequence[Setup]",
        *,
        leds: Sequence[str] = (),
        turns: int | None = None,
    ) -> None:
        """For a folder, which need not be there yet.

        Args:
            request: for `material_nodes`.
            setups: what lights the pictures; see `one_setup`.
            leds: pictures under the rig's own lights as well.
            turns: so many steps in which the first picture's environment turns once round.

        Raises:
            RequestError: the rig has no such light, there can be no such folder, or a file is not this command's.
        """
        from lightstage.formats.whole_set import WholeSet

        self.request = request
        self._session, self._store, self._folder, self._turns = session, store, folder, turns
        self._compared = bool(leds)
        self._setups = [*setups, *own_lights(leds, request, store)]
        self._set = WholeSet(folder, names.RELIGHT_RECORD, subject={"session": session.name})
        with refusals():
            self._set.claim(names.relit([setup.name for setup in self._setups], turns=bool(turns)))

    def deliver(
        self,
        answer: Answer,
        *,
        exposure: float | None = None,
        tracking: int | None = None,
        progress: Progress = silent,
    ) -> Delivered:
        """Write the files, of the answer to the request.

        Args:
            exposure: of the PNG; None: one for all pictures, by the brightest.

        Raises:
            RequestError: there is no such tracking frame, or nothing is known of the subject.
            OSError: a file cannot be written.
        """
        from lightstage.products import relit

        stack = opened(answer, ("stack",))["stack"]
        material = material_of(answer, self.request, self._session, self._store, tracking=tracking)
        document = relit.document(material)
        with refusals(), self._set.making() as work:
            surface = relit.surface_of(material)
            taken = relit.own_pictures(material, self._setups, stack) if self._compared else {}
            entries, rows = relit.write_pictures(
                work, material, surface, self._setups, exposure, taken, progress=progress
            )
            if self._turns:
                entries |= relit.write_turn(
                    work, material, surface, self._setups[0], rows[0].exposure, self._turns, progress=progress
                )
            entries |= relit.write_table(work, rows)
            entries |= relit.write_sheet(work, rows)
            recorded = {name: {**entry, "results": document["results"]} for name, entry in entries.items()}
            files = self._set.settle(work, document, recorded)
        return Delivered(
            files=(*files, self._folder / names.RELIGHT_RECORD),
            entries=entries,
            document=document,
            glossy=material.gloss is not None,
            absolute=material.absolute,
            rows=tuple(rows),
        )


def one_setup(
    lights: Sequence[tuple[float, float, float]],
    map_file: Path | None = None,
    *,
    count: int | None = None,
    rotate_deg: float | None = None,
) -> "list[Setup]":
    """The picture that all distant lights and an environment light together, if there are any.

    Args:
        lights: azimuth and elevation in degrees, and strength.
        map_file: of the environment.
        count: lights that stand for it.
        rotate_deg: at 90 what was towards the camera is at the picture's right.

    Raises:
        RequestError: there is no such map.
    """
    from lightstage.products.light_setups import Distant, environment_lamps, one_picture

    distant = [Distant(*light) for light in lights]
    if map_file is None:
        return one_picture(distant, None)
    lamps = environment_lamps(environment(map_file), count or choices.ENVIRONMENT_LIGHTS, rotate_deg or 0.0)
    turn = f" turned by {rotate_deg:g}" if rotate_deg else ""
    return one_picture(distant, lamps, map_file.name + turn)
