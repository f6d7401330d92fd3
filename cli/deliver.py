"""Files for a folder of the user's: made aside, moved in when all of them are there.

A record beside them (JSON) names each with the digest of its bytes and the results it was made from. A file of the
same name is replaced only where the record says that it is as this command has left it: nothing of anybody else's
is overwritten. A folder holds the files of one session.
"""

import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lightstage.store.digest import digest_bytes
from lightstage.store.errors import RequestError, WorkError
from lightstage.store.intake import read_regular

_LARGEST_RECORD = 64 << 20


def noted(picture: Path, shown: str) -> str:
    """What stands beside a picture that the store keeps: which results it shows, and the digest of its bytes."""
    return f"{shown}{digest_bytes(picture.read_bytes())}\n"


class Delivery:
    """What one command puts into one folder."""

    def __init__(self, to: Path, record: str) -> None:
        """For a folder, which need not be there yet.

        Args:
            to: the folder.
            record: the record's name, which says which command's files they are.
        """
        self.to = to
        self.record = record

    def claim(self, names: Iterable[str], session: str) -> None:
        """Make the folder, and make sure that these files may be written; to be asked before the work.

        Raises:
            RequestError: there can be no such folder, or it holds a file that is not this command's, or the files
                of another session.
        """
        try:
            self.to.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RequestError(f"--to {self.to}: no folder can be made there ({error.strerror})") from None
        known, former = self._known()
        if former not in (None, session):
            raise RequestError(f"--to {self.to} holds the files of session '{former}'; choose another folder")
        for name in names:
            path = self.to / name
            if path.exists() and not (path.is_file() and known.get(name) == digest_bytes(path.read_bytes())):
                raise RequestError(
                    f"{path} is there already and is not as {self.record} describes it; "
                    "move it away, or choose another --to"
                )

    def _known(self) -> tuple[dict[str, str], str | None]:
        """Name to digest, of what the record lists, and whose files they are."""
        path = self.to / self.record
        if not path.exists():
            return {}, None
        try:
            record = json.loads(read_regular(path, _LARGEST_RECORD))
            listed = {str(name): str(entry["digest"]) for name, entry in record["files"].items()}
            return listed, str(record["session"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            raise RequestError(
                f"{path} is there already and is no record of this command; move it away, or choose another --to"
            ) from None

    @contextmanager
    def making(self) -> Iterator[Path]:
        """A folder to write into; what is in it when the block ends well is handed over by `settle`.

        Raises:
            WorkError: it cannot be written.
        """
        try:
            with tempfile.TemporaryDirectory(prefix=".lightstage-", dir=self.to) as work:
                yield Path(work)
        except OSError as error:
            raise WorkError(f"{self.to} cannot be written ({error.strerror or error})") from None

    def settle(self, work: Path, document: Mapping[str, Any], files: Mapping[str, Mapping[str, Any]]) -> list[Path]:
        """Write the record and move the files in; returns where they are, the record last.

        Files of earlier calls stay in the record, so that they can be replaced later.

        Args:
            work: the folder of `making`.
            document: what the record says beside the files; `results` is said of each file of this call.
            files: by name, what the record says of each.
        """
        path = self.to / self.record
        former = json.loads(path.read_text(encoding="utf-8"))["files"] if path.exists() else {}
        listed = {
            **{name: entry for name, entry in former.items() if (self.to / name).exists()},
            **{
                name: {
                    **entry,
                    "results": document.get("results"),
                    "digest": digest_bytes((work / name).read_bytes()),
                }
                for name, entry in files.items()
            },
        }
        (work / self.record).write_text(
            json.dumps({**document, "files": listed}, indent=1) + "\n", encoding="utf-8"
        )
        # the record first: should this stop half-way, what is old there is said not to be ours
        for name in (self.record, *files):
            os.replace(work / name, self.to / name)
        return [*(self.to / name for name in files), path]
