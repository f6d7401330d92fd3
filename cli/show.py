"""What a person sees: tables, progress bars, warnings. With --json only the document goes to stdout."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lightstage.api.errors import WorkError

if TYPE_CHECKING:
    from lightstage.api.stores import OpenStore


class Screen:
    """Where a command says things.

    A terminal that has no letter for a character gets its number (`\\xe4`). Output that cannot be written, to a
    full disk for instance, fails the command; output that nobody reads any more ends it.
    """

    def __init__(self, *, as_json: bool) -> None:
        self.as_json = as_json
        self._live: Any = None
        for stream in (sys.stdout, sys.stderr):
            if getattr(stream, "errors", None) == "strict" and hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")

    def say(self, text: str = "") -> None:
        """A line of the command's answer."""
        if not self.as_json:
            self._print(text)

    def flush(self) -> None:
        """Everything that was said is written, or this says that it is not."""
        with written():
            if sys.stdout is not None:
                sys.stdout.flush()

    def close(self) -> None:
        """Nothing more is written to stdout, not even what waits there."""
        with contextlib.suppress(OSError, ValueError, AttributeError):
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, sys.stdout.fileno())
            os.close(nothing)

    def _print(self, text: str) -> None:
        with written():
            print(text)

    def warn(self, text: str) -> None:
        """Something that the user should know, on stderr."""
        if self._live is not None:
            self._live.console.print(f"note: {text}", markup=False, highlight=False)
        else:
            print(f"note: {text}", file=sys.stderr)

    def document(self, value: Mapping[str, Any]) -> None:
        """The answer as JSON, when it was asked for."""
        if self.as_json:
            self._print(json.dumps(value, indent=1, default=str))

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Any]], *, right: Sequence[int] = ()) -> None:
        """Columns, aligned; those in `right` to the right."""
        if self.as_json:
            return
        cells = [[str(cell) for cell in row] for row in [head, *rows]]
        widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
        for row in cells:
            parts = [
                cell.rjust(width) if i in right else cell.ljust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            self._print("  ".join(parts).rstrip())

    @property
    def lively(self) -> bool:
        """Whether somebody watches."""
        return sys.stderr.isatty() and not self.as_json

    def progress(self, items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
        """Pass items on and show how far it is, with rate and time left."""
        if not self.lively:
            return items
        return self._progress(items, total, what)

    def _progress(self, items: Iterable[Any], total: int, what: str) -> Iterator[Any]:
        with _bars(what) as bars:
            task = bars.add_task(what, total=total)
            for item in items:
                yield item
                bars.advance(task)


@contextlib.contextmanager
def written() -> Iterator[None]:
    """What cannot be written to stdout is a failure with a name.

    Raises:
        WorkError: the disk that it goes to is full, for instance.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise WorkError(f"the answer cannot be written to stdout ({error.strerror})") from None


def _bars(unit: str) -> Any:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            speed = task.finished_speed or task.speed
            each = task.fields.get("units_each", 1.0)
            return Text(f"{speed * each:.1f} {unit}/s" if speed else "", style="cyan")

    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=Console(stderr=True), transient=True)


def say_where_none_is(store: "OpenStore", screen: "Screen") -> None:
    """A word where a store is looked at that is not there: its name may be misspelt."""
    if not store.exists:
        screen.warn(f"there is no store at {store.root} yet; `lightstage import FOLDER` makes it")


class RunWatcher:
    """Shows a run: one bar a stage, with frames per second and time left."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        self.began = time.perf_counter()

    def __enter__(self) -> "RunWatcher":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._screen._live = None

    def begin(self, totals: Mapping[str, int], frames: int) -> None:
        """Blocks to do, by node, and the session's frames that they stand for."""
        if not self._screen.lively:
            return
        if self._bars is not None:
            self._bars.stop()
        self._bars = _bars("frames")
        self._screen._live = self._bars
        self._tasks = {
            name: self._bars.add_task(name, total=total, units_each=frames / total)
            for name, total in totals.items()
            if total
        }
        self._bars.start()

    def done(self, node: str, computed: bool) -> None:
        """One block of a node is there."""
        if node in self._tasks:
            self._bars.advance(self._tasks[node])

    def warn(self, text: str) -> None:
        """Something that the user should know."""
        self._screen.warn(text)
