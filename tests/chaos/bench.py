"""The tiny capture and its store, commands in processes of their own, and the truth that a trial compares with.

A process that has imported everything and started no thread forks one process for each command, so that a command
costs milliseconds and still has its own memory, its own limits and its own end.
"""

import atexit
import contextlib
import importlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xxhash
import yaml
from numpy.typing import NDArray

from tests.chaos.interference import Interference
from tests.chaos.outcome import HangError, UnclearError, WrongError
from tests.package import use_package
from tests.scenes import STATIC, ideal_gradient, sphere_normals, write_capture

REPOSITORY = Path(__file__).resolve().parent.parent.parent
SHAPE = (18, 24)
HANG_S = 60.0
PIPELINE = """stages:
  capture:  {uses: capture}
  register: {uses: register, from: capture}
  split:    {uses: split,    from: register}
  stack:    {uses: stack,    from: split}
  align:    {uses: align,    from: stack}
  normals:  {uses: normals,  from: align}
"""
_UNCLEAR = re.compile(r"Traceback \(most recent|lightstage: unexpected |\"error\": \"unexpected ")
NODES = ("capture", "register", "split", "stack", "align", "normals")
RATIO = ("--set", "normals.method=ratio")
"""A second request, so that a store holds an answer that may be taken for another."""


def warm(store: Path | None = None, options: Sequence[str] = ()) -> None:
    """Import what commands import, so that their processes need not; leaves no thread behind.

    With a store: know what they look up in our sources and in installed packages, too.
    """
    for name in ("zarr", "xarray", "cv2", "numba", "dask.threaded", "distributed", "scipy.ndimage", "numcodecs"):
        importlib.import_module(name)
    for name in (
        "lightstage.cli.main",
        "lightstage.dag.run",
        "lightstage.dag.recall",
        "lightstage.dag.graph",
        "lightstage.store.importer",
        "lightstage.store.verify",
        "lightstage.store.gc",
    ):
        importlib.import_module(name)
    from lightstage.cli.main import build_parser
    from lightstage.stages import TABLE

    build_parser()
    for module in TABLE.values():
        importlib.import_module(module)
    if store is None:
        return
    import zarr.core.sync

    from lightstage.cli.main import main

    with contextlib.redirect_stdout(None):
        main(["--store", str(store), "status", *options])
        main(["--store", str(store), "export", "normals", *options[:2], "--to", f"{store}-warm", "--format", "npy"])
    shutil.rmtree(f"{store}-warm")
    zarr.core.sync.cleanup_resources()


@dataclass(frozen=True)
class Answer:
    """What a command said, and what it cost."""

    words: tuple[str, ...]
    code: int | None
    """None: it was still at work when its time was over."""
    out: str
    err: str
    seconds: float
    peak_bytes: int

    def __str__(self) -> str:
        said = (self.err.strip() or self.out.strip()).replace("\n", " / ")
        return f"`{' '.join(self.words)[:200]}` exit {self.code}: {said[-300:]}"

    @property
    def json(self) -> Any:
        """The document on stdout."""
        return json.loads(self.out)

    def clear(self) -> "Answer":
        """This answer, if it is one: done, or one sentence.

        Raises:
            HangError, UnclearError: it is not.
        """
        if self.code is None:
            raise HangError(str(self))
        if _UNCLEAR.search(self.err) or _UNCLEAR.search(self.out):
            raise UnclearError(str(self))
        if self.code not in (0, 1, 2):
            raise UnclearError(str(self))
        if self.code != 0 and "lightstage: " not in self.err and "damaged: " not in self.out:
            raise UnclearError(f"{self} (no sentence)")
        return self

    def done(self) -> "Answer":
        """This answer, if the command did what was asked."""
        if self.clear().code != 0:
            raise UnclearError(str(self))
        return self


@dataclass
class Command:
    """A command in a process of its own."""

    words: Sequence[str | Path]
    store: Path
    room: Path
    """The folder that holds home, working folder and temporary folder, made as they are needed."""
    env: Mapping[str, str] = field(default_factory=dict)
    interference: Sequence[Interference] = ()
    limits: Mapping[int, int] = field(default_factory=dict)
    """RLIMIT_... -> value."""
    checkout: Path | None = None
    """Another checkout whose code it runs."""
    before: Callable[[], None] | None = None
    """Called in the process before the command."""
    then: Sequence[Sequence[str | Path]] = ()
    """More commands that the same process does afterwards; the worst exit code counts."""
    pid: int = 0
    _began: float = 0.0
    _answer: Answer | None = None

    def start(self) -> "Command":
        """Fork it."""
        self.room.mkdir(parents=True, exist_ok=True)
        handle, self._said = tempfile.mkstemp(dir=self.room, prefix=".said-")
        os.close(handle)
        self._began = time.monotonic()
        self.pid = os.fork()
        if self.pid == 0:
            self._be()
        return self

    def _be(self) -> None:
        code = 70
        try:
            os.setpgid(0, 0)
            sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
            for number, suffix in ((1, ""), (2, ".err")):
                target = os.open(self._said + suffix, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.dup2(target, number)
                os.close(target)
            nothing = os.open(os.devnull, os.O_RDONLY)
            os.dup2(nothing, 0)
            for name in ("home", "cwd", "tmp"):
                (self.room / name).mkdir(exist_ok=True)
            os.environ |= {"HOME": str(self.room / "home"), "TMPDIR": str(self.room / "tmp"), **self.env}
            tempfile.tempdir = None
            os.chdir(self.room / "cwd")
            if self.checkout is not None:
                use_package(self.checkout)
            if self.before is not None:
                self.before()
            for limit, value in self.limits.items():
                resource.setrlimit(limit, (value, value))
            for one in self.interference:
                one.install()
            from lightstage.cli.main import main

            code = max(main(["--store", str(self.store), *map(str, words)]) for words in (self.words, *self.then))
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except BaseException:  # noqa: BLE001  (this is where the process ends, whatever came)
            import traceback

            traceback.print_exc()
        finally:
            with contextlib.suppress(BaseException):
                threading._shutdown()  # type: ignore[attr-defined]
                atexit._run_exitfuncs()
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)

    def ended(self) -> bool:
        """Whether it has come to its end."""
        if self._answer is None:
            pid, status, usage = os.wait4(self.pid, os.WNOHANG)
            if pid:
                self._take(os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024)
        return self._answer is not None

    def _take(self, code: int | None, peak: int) -> None:
        texts = []
        for suffix in ("", ".err"):
            path = Path(self._said + suffix)
            texts.append(path.read_text(errors="replace") if path.exists() else "")
            path.unlink(missing_ok=True)
        words = tuple(map(str, self.words))
        self._answer = Answer(words, code, *texts, time.monotonic() - self._began, peak)

    def wait(self, timeout_s: float = HANG_S) -> Answer:
        """Its answer; one that takes longer is killed with all that it started."""
        pause = 0.002
        while not self.ended():
            if time.monotonic() - self._began > timeout_s:
                self.kill()
                os.wait4(self.pid, 0)
                self._take(None, 0)
                break
            time.sleep(pause)
            pause = min(0.05, pause * 1.3)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)  # what it left running
        assert self._answer is not None
        return self._answer

    def kill(self) -> None:
        """SIGKILL, to all of it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)


def picture(illumination: str, camera: str, *, seed: int = 0) -> NDArray[np.uint16]:
    """Counts of the tiny sphere, textured so that every picture has its own."""
    normals, _ = sphere_normals(SHAPE[1])
    normals = normals[:, 3:-3]
    generator = np.random.default_rng([seed, STATIC.index(illumination)])
    diffuse = 500 * ideal_gradient(normals, illumination) + generator.normal(20, 4, SHAPE)
    cross = diffuse / 2
    if camera == "CAM0":
        return np.round(np.roll(cross + 90 * ideal_gradient(normals, illumination), 1, axis=1)).astype(np.uint16)
    return np.round(cross).astype(np.uint16)


def item(kind: str, version: int = 0) -> dict[str, Any]:
    """A calibration item of a kind; another version has other numbers."""
    if kind == "homography":
        matrix = [[1, 0, -1 - version / 2], [0, 1, 0], [0, 0, 1]]
        return {"item": kind, "from": "CAM0", "to": "CAM1", "matrix": matrix}
    if kind == "bands":
        return {"item": kind, "bands": [{"centre_nm": 576, "exposure": 3.0 + version, "transmission": 0.9}]}
    names = {camera: f"{kind}_{camera}.png" for camera in ("CAM0", "CAM1")}
    return {"item": kind, "images": names, "scale": 1.0 + version / 4}


KINDS = ("homography", "bands", "dark", "flat")


def capture_folder(folder: Path) -> Path:
    """The tiny capture: two cameras, seven illuminations, four items, a mask-free sphere of 24 x 18 pixels."""
    cameras = {"parallel": "CAM0", "cross": "CAM1"}
    pictures = {(i, 576, p): picture(n, cameras[p]) for i, n in enumerate(STATIC) for p in cameras}
    generator = np.random.default_rng(5)
    dark = {f"dark_{c}.png": generator.integers(8, 14, SHAPE).astype(np.uint16) for c in cameras.values()}
    flat = {f"flat_{c}.png": generator.integers(690, 720, SHAPE).astype(np.uint16) for c in cameras.values()}
    items = {kind: item(kind) for kind in KINDS}
    return write_capture(folder, pictures, illumination=STATIC, items=items, item_pictures=dark | flat)


@dataclass(frozen=True)
class Truth:
    """What a store must give: the exported values of every node, by request."""

    usual: Mapping[str, NDArray[Any]]
    ratio: Mapping[str, NDArray[Any]]


class Bench:
    """The capture, a store that holds it with the results of two requests, and room for a trial."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.capture = folder / "ball"
        self.base = folder / "store"
        self.imported = folder / "imported"
        self.pipeline = folder / "pipeline.yaml"
        self.items = folder / "items"

    def prepare(self) -> "Bench":
        """Make them once."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.pipeline.write_text(PIPELINE)
        capture_folder(self.capture)
        shutil.copytree(self.capture / "calibration", self.items)
        for kind in KINDS:
            (self.items / f"{kind}.yaml").write_text(yaml.safe_dump(item(kind, 1), sort_keys=False))
        trial = Trial(self, self.folder / "preparation", 0)
        trial.command("import", self.capture, store=self.imported).done()
        copy(self.imported, self.base)
        trial.command("run", *trial.options, *RATIO, store=self.base).done()
        ratio = trial.exported(store=self.base, truth=True)
        trial.command("run", *trial.options, store=self.base).done()
        usual = trial.exported(store=self.base, truth=True)
        for name, values in (("usual", usual), ("ratio", ratio)):
            np.savez(self.folder / f"{name}.npz", **values)
        shutil.rmtree(trial.room)
        warm(self.base, trial.options)
        return self

    def once(self, name: str, make: Callable[[Path, "Bench"], None]) -> Path:
        """The store that `make` leaves in a room, made by the first trial that asks for it."""
        room = self.folder / name
        if not room.exists():
            mine = self.folder / f"{name} {os.getpid()}"
            mine.mkdir()
            make(mine, self)
            with contextlib.suppress(OSError):  # another trial was quicker
                os.rename(mine, room)
            shutil.rmtree(mine, ignore_errors=True)
        return room / "store"

    def truth(self) -> Truth:
        """The values, from files: a trial is a process of its own."""
        values = []
        for name in ("usual", "ratio"):
            with np.load(self.folder / f"{name}.npz") as file:
                values.append(dict(file))
        return Truth(*values)


class Trial:
    """One trial's room: a store of its own and commands on it."""

    def __init__(self, bench: Bench, room: Path, seed: int) -> None:
        self.bench, self.room, self.seed = bench, room, seed
        self.store = room / "store"
        self.options = ("--session", "ball", "--pipeline", str(bench.pipeline))
        room.mkdir(parents=True, exist_ok=True)

    def command(self, *words: str | Path, store: Path | None = None, **more: Any) -> Answer:
        """A command's answer."""
        timeout_s = more.pop("timeout_s", HANG_S)
        return self.start(*words, store=store, **more).wait(timeout_s)

    def start(self, *words: str | Path, store: Path | None = None, **more: Any) -> Command:
        """A command at work."""
        return Command(words, store or self.store, self.room, **more).start()

    def run(self, *words: str, **more: Any) -> Answer:
        """`run` of the tiny pipeline."""
        return self.command("run", *self.options, *words, **more)

    def take_store(self, base: Path | None = None) -> Path:
        """A real copy of the prepared store, its hard links kept among themselves."""
        return copy(base or self.bench.base, self.store)

    def take_capture(self) -> Path:
        """A copy of the capture folder, to be edited."""
        return copy(self.bench.capture, self.room / "ball")

    def exported(
        self, nodes: Sequence[str] = NODES, *, store: Path | None = None, truth: bool = False
    ) -> dict[str, NDArray[Any]]:
        """The values that `export` gives, by node and file; empty for a node that ended with a sentence.

        Args:
            truth: every node must be exported.
        """
        values: dict[str, NDArray[Any]] = {}
        shutil.rmtree(self.room / "exported", ignore_errors=True)
        first, *then = [
            (
                "export",
                node,
                "--session",
                "ball",
                "--to",
                self.room / "exported" / node,
                "--format",
                "npy",
                "--json",
            )
            for node in nodes
        ]
        answer = self.command(*first, store=store, then=then).clear()
        if truth:
            answer.done()
        decoder, text = json.JSONDecoder(), answer.out.lstrip()
        for node in nodes:
            said, end = decoder.raw_decode(text)
            text = text[end:].lstrip()
            for file in said.get("files", ()):
                values[f"{node}/{Path(file).stem}"] = np.load(file)
        return values

    def check_exports(
        self,
        truth: Mapping[str, NDArray[Any]],
        after: str,
        *,
        all_of_them: bool = False,
        nodes: Sequence[str] = NODES,
    ) -> None:
        """Whatever is delivered is true.

        Raises:
            WrongError: it is not.
        """
        found = self.exported(nodes, truth=all_of_them)
        wanted = {name: values for name, values in truth.items() if name.split("/")[0] in nodes}
        have = {name.split("/")[0] for name in found}
        for name, values in wanted.items():
            if name.split("/")[0] in have and not same(found.get(name), values):
                raise WrongError(f"{name} exported after {after} is not what it should be")
        if extra := found.keys() - wanted.keys():
            raise WrongError(f"{min(extra)} exported after {after} should not be there")

    def healed(self, truth: Mapping[str, NDArray[Any]], after: str, capture: Path | None = None) -> None:
        """Verify, import and run: then everything is true, and nothing is left to complain about."""
        self.command("verify").clear()
        self.command("import", capture or self.bench.capture).done()
        self.run().done()
        self.check_exports(truth, f"{after}, verify, import, run", all_of_them=True)
        self.command("verify").done()


def same(found: NDArray[Any] | None, wanted: NDArray[Any]) -> bool:
    """Equal in type, shape and every bit that counts; NaN is NaN."""
    if found is None or found.dtype != wanted.dtype or found.shape != wanted.shape:
        return False
    return bool(np.array_equal(found, wanted, equal_nan=wanted.dtype.kind == "f"))


def copy(source: Path, target: Path) -> Path:
    """A real copy; hard links stay links among the copies."""
    subprocess.run(["cp", "-a", str(source), str(target)], check=True)
    return target


def files_of(folder: Path) -> Iterator[Path]:
    """Every file and link below a folder, in order."""
    for parent, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted([*files, *(f for f in folders if os.path.islink(os.path.join(parent, f)))]):
            yield Path(parent) / name


def tree(folder: Path) -> dict[str, str]:
    """Path -> digest of its bytes, or where it points to."""
    made = {}
    for path in files_of(folder):
        content = os.readlink(path).encode() if path.is_symlink() else path.read_bytes()
        made[path.relative_to(folder).as_posix()] = xxhash.xxh3_128_hexdigest(content)
    return made


def results(store: Path) -> dict[str, str]:
    """Every file of the results in use and of the raw group: path -> digest. Provenance has dates and is left
    out."""
    made = {}
    for current in sorted(store.glob("results/*/*/current")):
        group = current.parent / current.read_text().strip()
        made |= {f"{group.relative_to(store)}/{name}": digest for name, digest in tree(group).items()}
    for raw in sorted(store.glob("sessions/*/raw.zarr")):
        made |= {f"{raw.relative_to(store)}/{name}": digest for name, digest in tree(raw.resolve()).items()}
    return made
