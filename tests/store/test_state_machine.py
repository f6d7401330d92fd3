"""Import, edit, bind, run, kill, flip, gc, verify, remove, in any order: what is delivered is true or is not
delivered.

The model is a dictionary: the pictures in the folder, those in the session, the exposure that is bound, and per
node the values of the last run, worked out here. A kill raises at the nth change of a file and at every one
after it, as if the process were gone. LIGHTSTAGE_EXAMPLES asks for more than the few examples of the ordinary
suite.
"""

import contextlib
import gc
import io
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from numpy.typing import NDArray

from lightstage import stages
from lightstage.cli.main import main
from lightstage.dag import task as dag_task
from tests.scenes import one_camera_capture
from tests.store.tiny import PIPELINE, TABLE

FRAMES = ("C", "X", "Y")
EXPOSURES = (1.0, 2.0, 4.0)
GAINS = (1.0, 3.0)
CHANGES = ("link", "replace", "rename", "unlink", "mkdir", "symlink", "rmdir")
frames = st.integers(0, len(FRAMES) - 1)
Array = NDArray[Any]


class Killed(BaseException):
    """The process is gone."""


@contextlib.contextmanager
def killed_at(nth: int) -> Iterator[None]:
    """From the nth change of a file on, none is made."""
    count = 0

    def dying(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            nonlocal count
            count += 1
            if count >= nth:
                raise Killed
            return function(*given, **named)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in CHANGES:
            patch.setattr(os, name, dying(getattr(os, name)))
        yield


class StoreMachine(RuleBasedStateMachine):
    """A store, and the truth about it."""

    def __init__(self) -> None:
        super().__init__()
        self.room = Path(tempfile.mkdtemp())
        self.store = self.room / "store"
        self.folder = one_camera_capture(self.room / "c", FRAMES)
        (self.room / "pipeline.yaml").write_text(PIPELINE)
        for exposure in EXPOSURES:
            text = f"item: bands\nbands: [{{centre_nm: 0, exposure: {exposure}}}]\n"
            (self.room / f"bands-{exposure:g}.yaml").write_text(text)
        self.table, stages.TABLE = stages.TABLE, TABLE
        self.in_session: list[Array] | None = None
        self.exposure: float | None = None
        self.delivered: dict[str, Array] = {}
        self.damaged = False
        self.looked = 0

    def teardown(self) -> None:
        stages.TABLE = self.table
        dag_task._stores.clear()
        shutil.rmtree(self.room)

    def command(self, *words: str | Path) -> int:
        """The command as a new process would do it; what fails says so in one sentence."""
        dag_task._stores.clear()  # what a process remembers of a store
        out, err = io.StringIO(), io.StringIO()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = main(["--store", str(self.store), *map(str, words)])
        finally:
            dag_task._stores.clear()
            gc.collect(0)
        said = out.getvalue() + err.getvalue()
        assert code in (0, 1, 2)
        assert "unexpected" not in said, said
        assert code == 0 or "lightstage: " in said or "damaged: " in said, said
        return code

    def pictures(self) -> list[Array]:
        """What lies in the capture folder."""
        return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(self.folder.glob("*.png"))]

    def run_words(self, gain: float, *more: str) -> tuple[str | Path, ...]:
        return (
            "run",
            "--session",
            "c",
            "--pipeline",
            self.room / "pipeline.yaml",
            "--set",
            f"scaled.gain={gain}",
            *more,
        )

    def bind_words(self, exposure: float) -> tuple[str | Path, ...]:
        return ("calibration", "use", self.room / f"bands-{exposure:g}.yaml", "--session", "c")

    def done(self, *words: str | Path) -> bool:
        """Whether a command did its work; in a store that is not damaged it must."""
        code = self.command(*words)
        if code:
            assert self.damaged, words
            self.recover()
        return code == 0

    def recover(self) -> None:
        """Verify, import, bind and run mend whatever there was."""
        self.command("verify")
        assert self.command("import", self.folder) == 0
        self.in_session = self.pictures()
        if self.exposure is not None:
            assert self.command(*self.bind_words(self.exposure)) == 0
        self.damaged = False
        self.run_fully(GAINS[0])
        assert self.command("verify") == 0

    def scaled(self, gain: float) -> Array:
        assert self.in_session is not None
        return np.stack(
            [(p[None, None] * (gain / (self.exposure or 1.0))).astype(np.float32) for p in self.in_session]
        )

    @initialize()
    def import_first(self) -> None:
        self.import_folder()

    @rule()
    def import_folder(self) -> None:
        if self.done("import", self.folder):
            self.in_session = self.pictures()

    @rule(frame=frames, by=st.integers(1, 40))
    def edit(self, frame: int, by: int) -> None:
        path = sorted(self.folder.glob("*.png"))[frame]
        assert cv2.imwrite(str(path), (self.pictures()[frame] + by) % 1024)

    @rule(first=frames, second=frames)
    def swap(self, first: int, second: int) -> None:
        paths = sorted(self.folder.glob("*.png"))
        data = paths[first].read_bytes(), paths[second].read_bytes()
        paths[first].write_bytes(data[1])
        paths[second].write_bytes(data[0])

    @precondition(lambda self: self.in_session is not None)
    @rule(exposure=st.sampled_from(EXPOSURES))
    def bind(self, exposure: float) -> None:
        if self.done(*self.bind_words(exposure)):
            self.exposure = exposure

    @precondition(lambda self: self.in_session is not None)
    @rule(gain=st.sampled_from(GAINS))
    def run_fully(self, gain: float) -> None:
        if self.done(*self.run_words(gain)):
            scaled = self.scaled(gain)
            total = scaled.astype(np.float64).sum(axis=0).astype(np.float32)
            self.delivered = {"scaled": scaled, "summed": total}

    @precondition(lambda self: self.in_session is not None)
    @rule(gain=st.sampled_from(GAINS), first=frames)
    def run_a_frame(self, gain: float, first: int) -> None:
        if self.done(*self.run_words(gain, "--frames", f"{first}:{first + 1}")):
            scaled = np.full_like(self.scaled(gain), np.nan)
            scaled[first] = self.scaled(gain)[first]
            self.delivered["scaled"] = scaled

    @precondition(lambda self: self.in_session is not None)
    @rule(
        what=st.sampled_from(["import", "run", "bind", "gc", "verify", "remove"]),
        nth=st.integers(1, 60),
        exposure=st.sampled_from(EXPOSURES),
        gain=st.sampled_from(GAINS),
    )
    def kill(self, what: str, nth: int, exposure: float, gain: float) -> None:
        """Killed in the middle, and done again: as if nothing had been."""
        words = {
            "import": ("import", self.folder),
            "run": self.run_words(gain),
            "bind": self.bind_words(exposure),
            "gc": ("gc", "--grace", "0s"),
            "verify": ("verify",),
            "remove": ("sessions", "remove", "c"),
        }[what]
        # an error that a command makes of the kill is as good: the process would be gone
        with contextlib.suppress(Killed), killed_at(nth):
            self.command(*words)
        if what == "remove" and not (self.store / "sessions" / "c" / "session.json").exists():
            self.exposure = None  # it went with the session
        elif what == "bind":
            self.exposure = exposure
        # a kill alone damages nothing; what is damaged already may stop any of these
        self.recover()

    @precondition(lambda self: self.in_session is not None)
    @rule(where=st.integers(0, 10**6), bit=st.integers(0, 10**6))
    def flip(self, where: int, bit: int) -> None:
        files = [
            p for p in sorted(self.store.rglob("*")) if p.is_file() and not p.is_symlink() and p.stat().st_size
        ]
        files = [p for p in files if p.name != "store.json" and self.store / "tmp" not in p.parents]
        path = files[where % len(files)]
        data = bytearray(path.read_bytes())
        data[bit // 8 % len(data)] ^= 1 << bit % 8
        path.chmod(0o644)
        with open(path, "r+b") as file:
            file.write(data)
        self.damaged = True

    @precondition(lambda self: self.in_session is not None)
    @rule()
    def free(self) -> None:
        self.done("gc", "--grace", "0s")

    @precondition(lambda self: self.in_session is not None)
    @rule()
    def verify(self) -> None:
        self.done("verify")

    @precondition(lambda self: self.in_session is not None and not self.damaged)
    @rule()
    def remove(self) -> None:
        if self.done("sessions", "remove", "c"):
            self.in_session, self.exposure, self.delivered = None, None, {}

    @precondition(lambda self: self.in_session is not None)
    @invariant()
    def what_is_delivered_is_true(self) -> None:
        """One node after each step, in turn."""
        assert self.in_session is not None
        self.looked += 1
        truths = {"capture": np.stack(self.in_session)[:, None, None], **self.delivered}
        node, truth = sorted(truths.items())[self.looked % len(truths)]
        to = self.room / "exported"
        if self.command("export", node, "--session", "c", "--to", to, "--format", "npy"):
            assert self.damaged, f"{node} is not delivered"
            self.recover()
        else:
            found = np.stack([np.load(path) for path in sorted(to.glob("*.npy"))])
            assert np.array_equal(found, truth.reshape(found.shape), equal_nan=truth.dtype.kind == "f"), node
        shutil.rmtree(to, ignore_errors=True)


# a kill leaves open what a process would take with it
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
EXAMPLES = int(os.environ.get("LIGHTSTAGE_EXAMPLES", "8"))
TestStoreMachine = StoreMachine.TestCase
TestStoreMachine.settings = settings(
    max_examples=EXAMPLES,
    stateful_step_count=14,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)
