"""Where products go: pictures that the store keeps, and files for a folder of the user's."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from lightstage.products.names import EXPORT_RECORD

EXPORT_FORMAT = "lightstage-export/1"


def keep_picture(path: Path, results: Sequence[Path], draw: Callable[[Path], object]) -> Path:
    """A picture in the store, drawn unless it shows these results already.

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
    from lightstage.store.digest import digest_bytes

    return "".join(f"{result}\n" for result in results) + f"{digest_bytes(picture.read_bytes())}\n"


class Export:
    """Files on their way into a folder of the user's."""

    def __init__(self, work: Path, folder: Path) -> None:
        self.work = work
        """Where they are written first."""
        self._folder = folder
        self.names: list[str] = []

    def add(self, names: Iterable[str]) -> None:
        """Files that are in `work` now."""
        self.names += names

    @property
    def files(self) -> list[str]:
        """Where they are, once the export has ended well."""
        return [str(self._folder / name) for name in self.names]


@contextmanager
def exported(folder: Path, session: str, node: str, names: Iterable[str]) -> Iterator[Export]:
    """An export of a node into a folder of the user's: all of it when the block ends well, or nothing.

    Its record tells what is whose: a file is replaced only where it is of this node and session and is as an export
    left it.

    Args:
        folder: need not be there.
        session, node: what is exported.
        names: of files that may be written.

    Raises:
        FormatError: there can be no such folder, or a file of that name is not this export's.
        OSError: it cannot be written.
    """
    from lightstage.formats.whole_set import WholeSet

    of = {"session": session, "node": node}
    delivery = WholeSet(folder, EXPORT_RECORD, of=of)
    delivery.claim(names)
    with delivery.making() as work:
        export = Export(work, folder)
        yield export
        delivery.settle(work, {"format": EXPORT_FORMAT}, dict.fromkeys(export.names, of))
