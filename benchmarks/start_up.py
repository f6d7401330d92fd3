"""What commands that compute nothing cost, as whole processes, beside `python -c "import numpy"` in the same rounds.

`python -m benchmarks.start_up` makes two stores in a temporary folder, of one session and of 300 (small ones: what a
command looks up does not hang on the size of pictures), and prints the least processor time of several rounds and its
ratio to numpy's. What asks about all sessions is given per session.
"""

import argparse
import os
import platform
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.scenes import sphere_capture

SESSIONS = 300
ONE = ("--session", "ball-000")
COMMANDS: dict[str, Sequence[str]] = {
    "status": ("status", *ONE),
    "why": ("why", "normals", *ONE),
    "graph": ("graph",),
    "path": ("path", "normals", *ONE),
    "run --dry-run": ("run", *ONE, "--dry-run"),
    "run, cached": ("run", *ONE),
}
OF_ALL: dict[str, Sequence[str]] = {"sessions list": ("sessions", "list"), "status of all": ("status",)}
NUMPY = (sys.executable, "-c", "import numpy")


def lightstage(store: Path, words: Sequence[str]) -> tuple[str, ...]:
    """The command line."""
    return (str(Path(sys.executable).parent / "lightstage"), "--store", str(store), *words)


def seconds(command: Sequence[str]) -> float:
    """User and system time of a process."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def filled(folder: Path, sessions: int) -> Path:
    """A store of small sessions, the first of which was run."""
    from lightstage.store.importer import import_capture
    from lightstage.store.root import Store

    store = Store(folder / f"store-{sessions}")
    for i in range(sessions):
        capture = sphere_capture(folder / f"capture-{sessions}-{i}", size=16)
        import_capture(capture, store, name=f"ball-{i:03d}")
    seconds(lightstage(store.root, ("run", *ONE)))
    return store.root


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--sessions", type=int, default=SESSIONS)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        stores = {count: filled(Path(folder), count) for count in (1, options.sessions)}
        calls = {
            (name, count): lightstage(store, words)
            for count, store in stores.items()
            for name, words in {**COMMANDS, **OF_ALL}.items()
        }
        least = dict.fromkeys(calls, float("inf"))
        numpy = float("inf")
        for _ in range(options.rounds + 1):  # the first also writes what later ones read
            numpy = min(numpy, seconds(NUMPY))
            for call, command in calls.items():
                least[call] = min(least[call], seconds(command))
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}; least of {options.rounds}"
    )
    print(f"`python -c 'import numpy'`: {1000 * numpy:.0f} ms of processor time\n")
    print(f"| command | store of 1, ms | of numpy's | store of {options.sessions}, ms | of numpy's |")
    print("|---|---|---|---|---|")
    for name in COMMANDS:
        one, many = least[name, 1], least[name, options.sessions]
        print(f"| {name} | {1000 * one:.0f} | {one / numpy:.2f} | {1000 * many:.0f} | {many / numpy:.2f} |")
    print("\n| command | store of 1, of numpy's | a further session, ms |")
    print("|---|---|---|")
    for name in OF_ALL:
        one, many = least[name, 1], least[name, options.sessions]
        print(f"| {name} | {one / numpy:.2f} | {1000 * (many - one) / (options.sessions - 1):.2f} |")


if __name__ == "__main__":
    main()
