"""Pages that show a session: its alignment, its pigments, its shape under single lights.

A page goes beside the store's results, where it is drawn anew each time, or to a place of the user's, where nothing
else is replaced.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.api.groups import open_group
from lightstage.api.refusals import refusals
from lightstage.products import names
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.products.skin import Point, Skin
    from lightstage.store.sessions import Session


@dataclass(frozen=True)
class AlignmentPage:
    """What a page of an alignment shows."""

    path: Path
    tracking: int
    points: tuple[tuple[int, int], ...]
    """(x, y) that are marked."""
    residual_before: float | None
    residual_after: float | None
    """Of the pairs; None where there are none."""


def alignment_page(
    session: "Session",
    store: Store,
    *,
    tracking: int | None = None,
    points: Sequence[tuple[int, int]] = (),
    file: Path | None = None,
) -> AlignmentPage:
    """Draw what `align` did to the pictures of one tracking frame.

    Args:
        tracking: the frame; None for the first.
        points: (x, y) to mark; none: textured places that move most.
        file: where; None: beside the store's results.

    Raises:
        RequestError: there is no such frame, a point is outside the picture, or something else is in the file's
            place.
    """
    from lightstage.formats.png import encode_png
    from lightstage.products.alignment import chosen_points, read_set, residual_of
    from lightstage.products.alignment_page import box, draw

    result, stack = (open_group(session, node, store) for node in ("align", "stack"))
    with refusals():
        aligned = read_set(session.name, result, stack, tracking)
    height, width = aligned.middle.captured.shape
    for x, y in points:
        if not (0 <= x < width and 0 <= y < height):
            raise RequestError(
                f"--at {x},{y} is outside the picture; X is 0 to {width - 1} and Y is 0 to {height - 1}"
            )
    marked = list(points) or chosen_points(aligned, box(width)[0])
    residual = residual_of(aligned)
    path = _keep(
        encode_png(draw(aligned, marked, residual)), file, store, names.alignment(session.name, aligned.tracking)
    )
    return AlignmentPage(
        path,
        aligned.tracking,
        tuple(marked),
        None if residual is None else residual.mean_before,
        None if residual is None else residual.mean_after,
    )


def skin_spectra(skin: "Skin", points: Sequence[tuple[int, int]]) -> "list[Point]":
    """The average of a skin and each point, or what is picked where none is given.

    Raises:
        RequestError: a point is outside the picture, or nothing is known there.
    """
    from lightstage.products.skin import spectra

    with refusals("--at " if points else ""):
        return spectra(skin, points)


def skin_pages(skin: "Skin", points: "Sequence[Point]", store: Store) -> dict[str, Path]:
    """The pages and the table of a skin; returns what is where.

    Raises:
        WorkError: they cannot be written.
    """
    from lightstage.formats.whole_file import write_whole
    from lightstage.products.skin import table
    from lightstage.products.skin_pages import maps_page, spectra_page

    folder = store.root / "pictures"
    files = {what: folder / name for what, name in names.skin(skin.session).items()}
    try:
        folder.mkdir(exist_ok=True)
        write_whole(files["picture"], maps_page(skin, points))
        write_whole(files["spectra"], spectra_page(skin, points))
        write_whole(files["table"], table(skin, points))
    except OSError as error:
        raise WorkError(f"{folder} cannot be written ({error.strerror or error})") from None
    return files


def light_previews(reliefs: Mapping[str, Any], store: Store, folder: Path | None = None) -> list[Path]:
    """A sheet a session: its shape under one light at a time.

    Args:
        reliefs: the normals of each session, opened.
        folder: where; None: beside the store's results.

    Raises:
        RequestError: the folder is a file, or something else is in a sheet's place.
    """
    from lightstage.products.stimuli import light_preview

    if folder is not None and folder.exists() and not folder.is_dir():
        raise RequestError(f"--to {folder}: is a file; name a folder")
    files = []
    for session, relief in reliefs.items():
        name = names.light_preview(session)
        sheet = light_preview(session, relief.normal.values[0, 0].astype("float32"))
        files.append(_keep(sheet, None if folder is None else folder / name, store, name))
    return files


def _keep(page: bytes, file: Path | None, store: Store, name: str) -> Path:
    """Write a page to a file of the user's, or under its name beside the store's results; returns where it is."""
    from lightstage.formats.whole_file import write_new, write_whole

    if file is not None:
        with refusals("--to "):
            write_new(file, page)
        return file
    path = store.root / "pictures" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, page)
    return path
