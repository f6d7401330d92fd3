"""Films of a session's normals: what the product is told of the session, and the film that the store keeps."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightstage.cli.deliver import keep_picture
from lightstage.cli.refusals import refusals
from lightstage.cli.show import Screen
from lightstage.store.root import Store

if TYPE_CHECKING:
    from lightstage.products.film import Film, Series
    from lightstage.store.sessions import Session


def series_of(dataset: Any, node: str, session: "Session") -> "list[Series]":
    """The normals of a node in time, one a band.

    Raises:
        RequestError: it holds none.
    """
    from lightstage.products.film import Subject, open_series

    subject = Subject(session.name, session.facts["illumination"], session.facts["frame_rate_hz"])
    with refusals():
        return open_series(dataset, node, subject)


def say_film(film: "Film", node: str, session: str, folder: Path, screen: Screen) -> None:
    """What was written."""
    scale = f"the scale of the change ends at {film.top_deg:g} degrees"
    if film.pace is not None:
        screen.say(f"{film.frames} frames at {film.pace}; {scale}")
    else:
        screen.say(f"{film.frames} pictures of {node} ({session}) in {folder}; {scale}")


def session_film(session: "Session", node: str, store: Store, screen: Screen) -> Path:
    """Draw a session's film beside its contact sheet, unless it shows the result in use already; returns its place.

    Of a result with several bands there is a film of each; the first one's place is returned.

    Raises:
        RequestError: the node has no normals in time.
    """
    from lightstage.products.film import write_series
    from lightstage.store.grid import open_dataset
    from lightstage.store.results import current_path

    result = current_path(session.name, node, store)
    series = series_of(open_dataset(result), node, session)

    def draw(path: Path) -> None:
        with refusals():
            for film in write_series(path.parent, series, form="mp4", progress=screen.progress):
                say_film(film, node, session.name, path.parent, screen)

    return keep_picture(store.root / "pictures" / f"{series[0].name}.mp4", [result], draw)
