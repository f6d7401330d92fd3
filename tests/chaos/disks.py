"""Disks that are full, read-only, without links, slow to tell, or gone.

A full disk is a tmpfs of one of 29 sizes where one can be mounted, a limit on the size of a file, and a refusal
at the nth write; a disk without links refuses every `link` and `symlink`. Each command ends with its work done
or with one sentence, nothing that was there is lost, and when the disk is well again a clean run is bit by bit
the undisturbed one.
"""

import contextlib
import errno
import os
import random
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path

from tests.chaos.bench import Trial, results
from tests.chaos.interference import At, Interference, Refused, Vanished
from tests.chaos.outcome import SkippedError, UnclearError, WrongError

SIZES_KB = tuple(16 + 24 * i for i in range(29))
NO_LINKS = (errno.EPERM, errno.EXDEV, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL, errno.EMLINK)
KINDS = (
    "a disk of a size",
    "no space at a write",
    "no links",
    "the store vanishes",
    "files no longer than",
    "few open files",
    "a read-only store",
)
TRIALS = len(SIZES_KB) + 8 * (len(KINDS) - 1)


def kind(seed: int) -> str:
    """The row of the table: every size once, then the others in turn."""
    return KINDS[0] if seed < len(SIZES_KB) else KINDS[1 + seed % (len(KINDS) - 1)]


def trial(made: Trial) -> None:
    """One disk."""
    dice = random.Random(f"disks {made.seed}")
    turn = made.seed // (len(KINDS) - 1)
    {
        "a disk of a size": _size,
        "no space at a write": _no_space,
        "no links": _no_links,
        "the store vanishes": _vanishes,
        "files no longer than": _short_files,
        "few open files": _few_files,
        "a read-only store": _read_only,
    }[kind(made.seed)](made, dice, turn)


def _well_again(made: Trial, said: str) -> None:
    """A clean import and run, on a disk that is well."""
    made.command("import", made.bench.capture).done()
    made.run().done()
    if results(made.store) != results(made.bench.base):
        raise WrongError(f"{said}; a clean run afterwards is another")
    made.command("verify").done()


def _sequence(made: Trial, **more: object) -> str:
    """Import, run, bind, verify, gc and export, each done or one sentence; what is exported is true."""
    said = []
    for words in (
        ("import", made.bench.capture),
        ("run", *made.options),
        ("calibration", "use", made.bench.items / "homography.yaml", "--session", "ball"),
        ("calibration", "use", made.bench.capture / "calibration" / "homography.yaml", "--session", "ball"),
        ("verify",),
        ("gc", "--grace", "0s"),
        ("run", *made.options),
    ):
        answer = made.command(*words, **more).clear()
        said.append(f"{words[0]} {answer.code}")
    return ", ".join(said)


def _size(made: Trial, dice: random.Random, turn: int) -> None:
    size = SIZES_KB[made.seed]
    with _mounted(made.store, f"size={size}k"):
        said = f"a disk of {size} kB: " + _sequence(made)
        made.check_exports(made.bench.truth().usual, said, nodes=("capture", "normals"))
        subprocess.run(["mount", "-o", "remount,size=64m", str(made.store)], check=True)
        _well_again(made, said)


@contextlib.contextmanager
def _mounted(folder: Path, options: str) -> Iterator[None]:
    folder.mkdir(parents=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        raise SkippedError("tmpfs cannot be mounted")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=False)


def _no_space(made: Trial, dice: random.Random, turn: int) -> None:
    base = dice.choice((None, made.bench.imported, made.bench.base))
    if base is not None:
        made.take_store(base)
    number = dice.choice((errno.ENOSPC, errno.EDQUOT, errno.EIO))
    nth = dice.randrange(1, 60)
    at = At(made.store, nth, ("create", "os.rename", "os.link", "os.mkdir"))
    words = dice.choice(
        (
            ("import", made.bench.capture),
            ("run", *made.options, "--set", "normals.method=minimal"),
            ("calibration", "use", made.bench.items / "dark.yaml", "--session", "ball"),
        )
    )
    said = f"{errno.errorcode[number]} at change {nth} of {words[0]}"
    made.command(*words, interference=[Interference(at, Refused(number))]).clear()
    made.command(
        "calibration", "use", made.bench.capture / "calibration" / "dark.yaml", "--session", "ball"
    ).clear()
    _well_again(made, said)


def _no_links(made: Trial, dice: random.Random, turn: int) -> None:
    number = NO_LINKS[turn % len(NO_LINKS)]
    refusals = [Interference(At(made.store, events=("os.link",)), Refused(number))]
    if turn // len(NO_LINKS) % 2:
        refusals.append(Interference(At(made.store, events=("os.symlink",)), Refused(errno.EPERM)))
    said = f"links refused by {errno.errorcode[number]}{', symbolic ones too' if len(refusals) > 1 else ''}"
    for words in (
        ("import", made.bench.capture),
        ("run", *made.options),
        ("run", *made.options, "--set", "normals.method=ratio"),
        ("verify",),
        ("gc", "--grace", "0s"),
        ("import", made.bench.capture),
        ("run", *made.options),
        ("verify",),
    ):
        made.command(*words, interference=refusals).done()
    made.check_exports(made.bench.truth().usual, said, all_of_them=True)


def _vanishes(made: Trial, dice: random.Random, turn: int) -> None:
    base = dice.choice((made.bench.imported, made.bench.base))
    made.take_store(base)
    away = made.room / "away"
    nth = dice.randrange(1, 120)
    words = dice.choice(
        (
            ("run", *made.options, "--set", "normals.method=minimal"),
            ("run", *made.options),
            ("import", made.take_capture()),
            ("verify",),
            ("gc", "--grace", "0s"),
        )
    )
    said = f"the store is moved away at call {nth} of {words[0]}"
    answer = made.command(
        *words, interference=[Interference(At(made.store, nth), Vanished(made.store, away))]
    ).clear()
    if not away.exists():
        return  # it ended before
    made.command("status", "--session", "ball").clear()
    if made.store.exists():
        left = sorted(p.relative_to(made.store).as_posix() for p in made.store.rglob("*") if not p.is_dir())
        if left:
            raise WrongError(f"{said} (exit {answer.code}); {left[0]} was made where it had been")
        subprocess.run(["rm", "-rf", str(made.store)], check=True)
    os.rename(away, made.store)
    _well_again(made, said)


def _short_files(made: Trial, dice: random.Random, turn: int) -> None:
    most = round(10 ** dice.uniform(3.0, 4.3))
    said = f"files of {most} bytes at most: "
    # the command's own output goes to a file, too
    said += _sequence(made, limits={resource.RLIMIT_FSIZE: most})
    _well_again(made, said)


def _few_files(made: Trial, dice: random.Random, turn: int) -> None:
    most = dice.randrange(8, 48)
    said = f"{most} open files at most: " + _sequence(made, limits={resource.RLIMIT_NOFILE: most})
    _well_again(made, said)


def _read_only(made: Trial, dice: random.Random, turn: int) -> None:
    with _mounted(made.store, "size=64m"):
        base = dice.choice((made.bench.imported, made.bench.base))
        subprocess.run(["cp", "-a", f"{base}/.", str(made.store)], check=True)
        subprocess.run(["mount", "-o", "remount,ro", str(made.store)], check=True)
        said = "a read-only store: " + _sequence(made)
        made.check_exports(made.bench.truth().usual, said)
        answer = made.command("status", "--session", "ball").clear()
        if answer.code:
            raise UnclearError(f"{said}; {answer}")
        subprocess.run(["mount", "-o", "remount,rw", str(made.store)], check=True)
        _well_again(made, said)
