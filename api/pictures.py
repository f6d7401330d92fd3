"""Pictures that the store keeps beside its results: a session's contact sheet, and the film of its normals."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lightstage.api.exports import series_of
from lightstage.api.refusals import refusals
from lightstage.products import names
from lightstage.products.progress import Progress, silent
from lightstage.store.digest import digest_bytes
from lightstage.store.grid import open_dataset
from lightstage.store.results import current_path
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.products.film import Film
    from lightstage.store.sessions import Session


def contact_sheet(session: "Session", store: Store) -> Path:
    """A session on one page, drawn unless it shows the results in use already; returns where it is.

    Raises:
        RequestError: the session has no normals yet.
    """
    results = [current_path(session.name, node, store) for node in ("stack", "normals")]

    def draw(path: Path) -> None:
        from lightstage.formats.whole_file import write_whole
        from lightstage.products.contact_sheet import contact_sheet

        stack, normals = (open_dataset(result) for result in results)
        with refusals():
            picture = contact_sheet(session.name, stack, normals, len(session.facts["illumination"]))
        write_whole(path, picture)

    return keep_picture(store.root / "pictures" / names.contact_sheet(session.name), results, draw)


def session_film(
    session: "Session",
    node: str,
    store: Store,
    *,
    written: "Callable[[Film], object]" = lambda film: None,
    progress: Progress = silent,
) -> Path:
    """A session's film, drawn unless it shows the result in use already; returns where it is.

    Args:
        written: is told of the film when it is drawn.

    Of a result with several bands there is a film of each; the first one's place is returned.

    Raises:
        RequestError: the node has no normals in time.
    """
    from lightstage.products.film import write_series

    result = current_path(session.name, node, store)
    series = series_of(open_dataset(result), node, session)

    def draw(path: Path) -> None:
        with refusals():
            for film in write_series(path.parent, series, form="mp4", progress=progress):
                written(film)

    return keep_picture(store.root / "pictures" / f"{series[0].name}.mp4", [result], draw)


def keep_picture(path: Path, results: Sequence[Path], draw: Callable[[Path], object]) -> Path:
    """A picture, drawn unless it shows these results already.

    A note beside it says which results it shows, and the digest of its bytes.

    Args:
        path: of the picture.
        results: what it shows.
        draw: writes it, whole or not at all.
    """
    note = path.with_suffix(".txt")
    if path.is_file() and note.is_file() and note.read_text() == _note(path, results):
        return path
    path.parent.mkdir(exist_ok=True)
    note.unlink(missing_ok=True)
    draw(path)
    note.write_text(_note(path, results))
    return path


def _note(picture: Path, results: Sequence[Path]) -> str:
    return "".join(f"{result}\n" for result in results) + f"{digest_bytes(picture.read_bytes())}\n"
