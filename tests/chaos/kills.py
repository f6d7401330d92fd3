"""A command is killed at one of its system calls, and then everything is done again.

The call is the nth of one kind, of those that a traced run of the same command made (strace injects SIGKILL); where
nothing can be traced, it is a moment by the clock. Wrong is a clean run afterwards that is not bit by bit what an
undisturbed one gives, a `verify` that then finds anything, and anything that one `gc` leaves behind.
"""

import os
import random
import re
import shutil
import subprocess
import tarfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from tests.chaos.bench import REPOSITORY, Bench, Command, Trial, files_of, results, tree
from tests.chaos.outcome import UnclearError, WrongError

TRIALS = 56
CALLS = (
    "openat,write,pwrite64,fsync,fdatasync,rename,renameat,renameat2,link,linkat,unlink,unlinkat,mkdir,mkdirat,"
    "symlink,symlinkat,rmdir,utimensat,ftruncate,close,newfstatat,getdents64,copy_file_range,sendfile"
)
DURABLE = (
    "write",
    "fsync",
    "rename",
    "renameat2",
    "link",
    "linkat",
    "unlink",
    "unlinkat",
    "mkdir",
    "symlink",
    "rmdir",
)

OPERATIONS = ("import", "run", "use", "gc", "verify", "remove", "import again", "upgrade")


def kind(seed: int) -> str:
    """The row of the table."""
    return f"killed in {OPERATIONS[seed % len(OPERATIONS)]}"


def trial(made: Trial) -> None:
    """One kill."""
    dice = random.Random(f"kills {made.seed}")
    operation = OPERATIONS[made.seed % len(OPERATIONS)]
    words = prepare(made, operation)
    calls = _calls(made.bench, operation) if _can_trace() else {}
    if calls:
        durable = [call for call in DURABLE if call in calls]
        call = dice.choice(durable if dice.random() < 0.7 else sorted(calls))
        nth = dice.randrange(calls[call]) + 1
        said = f"{operation} killed at {call} {nth} of {calls[call]}"
        _killed_at(made, words, call, nth)
    else:
        moment = dice.uniform(0.0, 0.5)
        said = f"{operation} killed after {moment:.3f} s"
        command = made.start(*words)
        time.sleep(moment)
        command.kill()
        command.wait()
    again(made, operation, words, said)


def prepare(made: Trial, operation: str) -> tuple[Any, ...]:
    """The store before an operation, and its words."""
    if operation == "import":
        return ("import", made.bench.capture)
    if operation == "upgrade":
        with tarfile.open(REPOSITORY / "tests" / "data" / "store-1.tar.xz") as old:
            old.extractall(made.room, filter="data")
        return ("upgrade",)
    if operation == "run":
        made.take_store(made.bench.imported)
        return ("run", *made.options)
    made.take_store()
    if operation == "import again":
        folder = made.take_capture()
        (folder / "0001_X_576nm_CAM1.png").write_bytes((folder / "0002_Y_576nm_CAM1.png").read_bytes())
        return ("import", folder)
    if operation == "gc":
        made.command("sessions", "remove", "ball").done()
        made.command("import", made.bench.capture).done()
    if operation == "verify":
        # something to mend: a result's chunk, and a link that somebody broke
        chunks = [p for p in files_of(made.store / "results") if p.name.startswith("c.")]
        for path in (chunks[3], chunks[-1]):
            data = bytearray(path.read_bytes())
            data[len(data) // 2] ^= 4
            with open(path, "r+b") as file:
                file.write(data)
    return {
        "use": ("calibration", "use", made.bench.items / "homography.yaml", "--session", "ball"),
        "gc": ("gc", "--grace", "0s"),
        "verify": ("verify",),
        "remove": ("sessions", "remove", "ball"),
    }[operation]


def again(made: Trial, operation: str, words: tuple[Any, ...], said: str) -> None:
    """The same again, a clean run, and what must be true then."""
    if operation != "gc":  # one is enough, also after a killed one
        answer = made.command(*words).clear()
        if answer.code == 2 and operation != "remove":
            raise UnclearError(f"{said}; done again: {answer}")
    if operation == "upgrade":
        wanted = results(made.bench.once("upgraded", _upgraded))
        if results(made.store) != wanted:
            raise WrongError(f"{said}; what the upgrade gives is another")
        made.command("verify").done()
    if operation in ("remove", "upgrade"):
        made.command("import", made.bench.capture).done()
    made.run().done()
    made.command("verify").done()
    made.command("gc", "--grace", "0s").done()
    found, wanted = results(made.store), _reference(made, operation)
    if found != wanted["results"]:
        raise WrongError(f"{said}; after a clean run {_first_difference(found, wanted['results'])} is another")
    left = leftovers(made.store) - wanted["files"]
    if left:
        raise WrongError(f"{said}; after a clean run and one gc {min(left)} is left ({len(left)} in all)")


def leftovers(store: Path) -> set[str]:
    """The files of a store by place; records are named by digests of paths and left out."""
    return {name for name in tree(store) if not name.startswith(("cache/runs", "cache/nodes", "cache/blocks"))}


def _reference(made: Trial, operation: str) -> dict[str, Any]:
    """The same without a kill, made in a room of its own once for each operation."""

    def undisturbed(room: Path, bench: Bench) -> None:
        other = Trial(bench, room, made.seed)
        words = prepare(other, operation)
        other.command(*words).clear()
        if operation in ("remove", "upgrade"):
            other.command("import", bench.capture).done()
        other.run().done()
        other.command("gc", "--grace", "0s").done()

    store = made.bench.once(f"undisturbed {operation}", undisturbed)
    return {"results": results(store), "files": leftovers(store)}


def _upgraded(room: Path, bench: Bench) -> None:
    other = Trial(bench, room, 0)
    other.command(*prepare(other, "upgrade")).done()


def _first_difference(found: dict[str, str], wanted: dict[str, str]) -> str:
    return min(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))


def _can_trace() -> bool:
    return shutil.which("strace") is not None


def _killed_at(made: Trial, words: tuple[Any, ...], call: str, nth: int) -> None:
    _traced(
        made, words, ["-o", os.devnull, "-e", f"trace={call}", "-e", f"inject={call}:signal=SIGKILL:when={nth}"]
    )


def _traced(made: Trial, words: tuple[Any, ...], options: list[str]) -> None:
    """A command under strace from just before its work."""
    ready, go = os.pipe(), os.pipe()

    def stand_by() -> None:
        os.write(ready[1], b"x")
        os.read(go[0], 1)

    command: Command = made.start(*words, before=stand_by)
    os.read(ready[0], 1)
    tracer = subprocess.Popen(
        ["strace", "-f", "-p", str(command.pid), *options], stderr=subprocess.PIPE, text=True, bufsize=1
    )
    assert tracer.stderr is not None
    said = tracer.stderr.readline()  # "strace: Process 123 attached"
    os.write(go[1], b"x")
    command.wait()
    tracer.wait()
    if "attached" not in said:
        raise UnclearError(f"strace: {said}")


def _calls(bench: Bench, operation: str) -> dict[str, int]:
    """How many system calls of each kind a thread of the operation makes at most; traced once."""

    def traced(room: Path, bench: Bench) -> None:
        other = Trial(bench, room, 0)
        words = prepare(other, operation)
        _traced(other, words, ["-o", str(room / "log"), "-e", f"trace={CALLS}"])

    log = bench.once(f"calls of {operation}", traced).with_name("log")
    counts = Counter(re.findall(r"^(\d+) +(\w+)\(", log.read_text(errors="replace"), re.MULTILINE))
    most: dict[str, int] = {}
    for (_, call), count in counts.items():
        most[call] = max(most.get(call, 0), count)
    return most
