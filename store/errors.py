"""The two ways in which something can fail, each with the exit code that the command returns."""

from collections.abc import Iterable
from pathlib import Path


class LightstageError(Exception):
    """One clear sentence for a person: what was wrong, where, and what would be right."""

    exit_code = 1


class WorkError(LightstageError):
    """The request was right, but the work failed: a full disk, a damaged chunk, a kernel that refused."""


class RequestError(LightstageError):
    """The request was wrong: a missing picture, a typo in YAML, an unknown session."""

    exit_code = 2


class DamagedChunkError(WorkError):
    """A stored chunk does not have the content that its name promises."""

    def __init__(self, message: str, blob: str) -> None:
        super().__init__(message)
        self.blob = blob

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        # a second argument is not in Exception.args, and workers send exceptions pickled
        return (DamagedChunkError, (str(self), self.blob))


class DamagedGroupError(WorkError):
    """A file of a result or of a session's pictures is not the one that was stored, or is gone."""

    def __init__(self, message: str, group: Path) -> None:
        super().__init__(message)
        self.group = group

    def __reduce__(self) -> tuple[type, tuple[str, Path]]:
        return (DamagedGroupError, (str(self), self.group))


class DamagedFileError(WorkError):
    """One of the store's own small files cannot be read."""

    def __init__(self, path: object, remedy: str) -> None:
        super().__init__(f"{path} is damaged; {remedy}")
        self.path, self.remedy = path, remedy

    def __reduce__(self) -> tuple[type, tuple[object, str]]:
        return (DamagedFileError, (self.path, self.remedy))


MOST_PROBLEMS = 20
"""Nobody reads more at once, and a file can have one in every line."""


def raise_all(problems: Iterable[str]) -> None:
    """Raise one RequestError that lists the problems, MOST_PROBLEMS at most, or return when there is none."""
    lines = [line for problem in problems for line in problem.splitlines()]
    if len(lines) > MOST_PROBLEMS:
        lines[MOST_PROBLEMS:] = [f"... and {len(lines) - MOST_PROBLEMS} more problems"]
    if lines:
        raise RequestError("\n".join(lines))
