"""A file of the user's, whole or not at all.

What is delivered is written beside its place, under a name of its own, and takes its name when it is whole. Where
that fails, what stood there stands, and nothing is left beside it.
"""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file to write into, which becomes `path` when the block ends well.

    It ends as `path` does, because some writers choose their format by that. Its folder must be there.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    beside = path.with_name(f".{path.stem[:100]}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield beside
        os.replace(beside, path)
    except OSError as error:
        if error.filename not in (None, str(beside)):
            raise  # of another file
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Put `data` at `path`, in place of what stood there, in one step.

    Raises:
        OSError: it cannot be written; the error names `path`.
    """
    with whole_file(path) as beside:
        beside.write_bytes(data)
