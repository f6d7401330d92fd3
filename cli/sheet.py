"""The contact sheet of a session, in the store's pictures."""

from pathlib import Path

from lightstage.cli.deliver import keep_picture
from lightstage.cli.refusals import refusals
from lightstage.products import names
from lightstage.store.results import current_path
from lightstage.store.root import Store


def contact_sheet(session: str, store: Store) -> Path:
    """Draw a session's contact sheet, unless it shows the results in use already, and return where it is.

    Raises:
        RequestError: the session has no normals yet.
    """
    results = [current_path(session, node, store) for node in ("stack", "normals")]

    def draw(path: Path) -> None:
        from lightstage.formats.whole_file import write_whole
        from lightstage.products.contact_sheet import contact_sheet as drawn
        from lightstage.store.grid import open_dataset
        from lightstage.store.sessions import read_session

        stack, normals = (open_dataset(result) for result in results)
        frames = len(read_session(session, store).facts["illumination"])
        with refusals():
            picture = drawn(session, stack, normals, frames)
        write_whole(path, picture)

    return keep_picture(store.root / "pictures" / names.contact_sheet(session), results, draw)
