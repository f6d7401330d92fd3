"""Files that belong together, all or nothing: a new folder, or a set of files in a folder of the user's.

A record beside the files of a set (JSON) names each with the digest of its bytes and with what it is of. A file of
the same name is replaced only where the record says that it is as this command has left it, and that it is of the
same thing: nothing of anybody else's, and nothing of another session or node, is overwritten.
"""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lightstage.formats.errors import FormatError
from lightstage.formats.whole_file import work_folder

_LARGEST_RECORD = 64 << 20
"""Bytes; the record of a million files has fewer."""


def write_folder(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Write a whole new folder, or nothing; False if the same is there. The folder's parent is made too.

    Args:
        folder: where.
        files: by name, which may have folders in it.

    Raises:
        FormatError: something else is there.
        OSError: it cannot be written; the error names `folder`.
    """
    if os.path.lexists(folder):
        if _same(folder, files):
            return False
        raise FormatError(f"{folder}: something is there already, and it is not this set; name a new folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with work_folder(folder.parent) as work:
            whole = work / folder.name
            whole.mkdir()
            for name, data in files.items():
                path = whole / name
                path.parent.mkdir(exist_ok=True, parents=True)
                path.write_bytes(data)
            os.rename(whole, folder)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(folder)) from error
    return True


def _same(folder: Path, files: Mapping[str, bytes]) -> bool:
    return folder.is_dir() and all(
        (folder / name).is_file() and (folder / name).read_bytes() == data for name, data in files.items()
    )


class WholeSet:
    """What one command puts into one folder."""

    def __init__(self, folder: Path, record: str, *, subject: Mapping[str, str]) -> None:
        """For a folder, which need not be there yet.

        Args:
            folder: where.
            record: the record's name, which says which command's files they are.
            subject: what the files are of, such as the session. What a record says of a whole folder, in the same
                words, must agree; so must what it says of a file that is to be replaced.
        """
        self.folder = folder
        self.record = record
        self.subject = dict(subject)

    def claim(self, names: Iterable[str]) -> None:
        """Make the folder, and make sure that these files may be written; to be asked before the work.

        Raises:
            FormatError: there can be no such folder, or it holds a file that is not this command's, or of another
                thing.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FormatError(f"{self.folder}: no folder can be made there ({error.strerror})") from None
        record = self._read()
        for what, name in self.subject.items():
            if record.get(what, name) != name:
                raise FormatError(
                    f"{self.folder} holds the files of {what} '{record[what]}'; choose another folder"
                )
        for name in names:
            self._check(name, record["files"].get(name))

    def _check(self, name: str, entry: Mapping[str, Any] | None) -> None:
        path = self.folder / name
        if not os.path.lexists(path):
            return
        if entry is None:
            raise FormatError(
                f"{path} is there already, and no {self.record} beside it says that it was delivered; "
                "move it away, or choose another folder"
            )
        if not path.is_file() or entry["digest"] != digest(path):
            raise FormatError(
                f"{path} is there already and is not as {self.record} describes it; "
                "move it away, or choose another folder"
            )
        others = [f"{what} '{entry[what]}'" for what, own in self.subject.items() if entry.get(what, own) != own]
        if others:
            raise FormatError(
                f"{path} is there already and is of {' and '.join(others)}; move it away, or choose another folder"
            )

    def _read(self) -> dict[str, Any]:
        """The record, or an empty one."""
        path = self.folder / self.record
        if not os.path.lexists(path):
            return {"files": {}}
        try:
            if not path.is_file() or path.stat().st_size > _LARGEST_RECORD:
                raise ValueError
            record = dict(json.loads(path.read_bytes()))
            record["files"] = {
                str(name): {**entry, "digest": entry["digest"]} for name, entry in record["files"].items()
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            raise FormatError(
                f"{path} is there already and is no record of this command; move it away, or choose another folder"
            ) from None
        return record

    @contextmanager
    def making(self) -> Iterator[Path]:
        """A folder to write into; what is in it when the block ends well is handed over by `settle`.

        Raises:
            OSError: it cannot be written; the error names the set's folder.
        """
        work = None
        try:
            with work_folder(self.folder) as work:
                yield work
        except OSError as error:
            ours = error.filename is None or str(error.filename).startswith(str(self.folder))
            if not ours:
                raise  # of another file
            raise OSError(error.errno, error.strerror or str(error), str(self.folder)) from error

    def settle(self, work: Path, document: Mapping[str, Any], files: Mapping[str, Mapping[str, Any]]) -> list[Path]:
        """Write the record and move the files in; returns where the files are.

        Files of earlier calls stay in the record, so that they can be replaced later.

        Args:
            work: the folder of `making`.
            document: what the record says beside the files.
            files: by name, what the record says of each.
        """
        former = self._read()["files"]
        listed = {
            **{name: entry for name, entry in former.items() if (self.folder / name).exists()},
            **{name: {**entry, "digest": digest(work / name)} for name, entry in files.items()},
        }
        text = json.dumps({**document, "files": listed}, indent=1) + "\n"
        (work / self.record).write_text(text, encoding="utf-8")
        # the record first: should this stop half-way, what is old there is said not to be ours
        for name in (self.record, *files):
            os.replace(work / name, self.folder / name)
        return [self.folder / name for name in files]


def digest(path: Path) -> str:
    """Of a file's bytes: 128 bits of xxh3, as 32 hexadecimal digits."""
    import xxhash

    return xxhash.xxh3_128_hexdigest(path.read_bytes())
