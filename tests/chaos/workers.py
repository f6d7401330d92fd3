"""Clusters that are not as they should be: nobody there, nobody working, killed, with other code, with another
store.

Every command comes to an end within a minute, with its work done or one sentence. What is left in the store is
right: a clean run on threads gives the undisturbed results, so that no worker has stored other numbers under
keys of ours.
"""

import os
import random
import resource
import socket
import time
from pathlib import Path

from tests.chaos.bench import Trial, copy, results
from tests.chaos.cluster import Cluster, can_see_instead, kill
from tests.chaos.interference import At, Held, Interference, Vanished
from tests.chaos.outcome import SkippedError, WrongError
from tests.package import copy_package

KINDS = (
    "nobody at the address",
    "no workers",
    "scheduler killed",
    "workers killed",
    "a copy of the store",
    "other code",
    "the store moved away",
    "few open files",
    "little memory",
    "an odd address",
)
TRIALS = 20
ADDRESSES = (
    "",
    "tls://127.0.0.1:1",
    "tcp://",
    "x",
    "tcp://127.0.0.1:99999",
    "inproc://x",
    "tcp://nowhere.invalid:1",
)


def kind(seed: int) -> str:
    """The row of the table."""
    return KINDS[seed % len(KINDS)]


def trial(made: Trial) -> None:
    """One cluster."""
    dice = random.Random(f"workers {made.seed}")
    what = kind(made.seed)
    made.take_store(made.bench.imported)
    said = what
    if what in ("nobody at the address", "an odd address"):
        address = ADDRESSES[made.seed // len(KINDS) % len(ADDRESSES)]
        if what == "nobody at the address":
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        answer = made.run("--scheduler", address).clear()
        said = f"--scheduler {address!r}"
        if answer.code == 0:
            raise WrongError(f"{said}: exit 0, though nobody is there")
    elif what in ("few open files", "little memory"):
        limit, value = (resource.RLIMIT_NOFILE, dice.choice((16, 24, 40)))
        if what == "little memory":
            limit, value = resource.RLIMIT_AS, dice.choice((600, 1500)) * 10**6
        said = f"--workers 2 with {what} ({value})"
        made.run("--workers", "2", limits={limit: value}).clear()
    else:
        with Cluster(made) as cluster:
            said = _on(cluster, made, what, dice)
    made.run().done()
    if results(made.store) != results(made.bench.base):
        raise WrongError(f"{said}; a clean run afterwards is another")
    made.command("verify").done()


def _on(cluster: Cluster, made: Trial, what: str, dice: random.Random) -> str:
    words = ("--scheduler", cluster.address)
    if what == "no workers":
        made.run(*words).clear()
        return what
    if what == "a copy of the store":
        if not can_see_instead():
            raise SkippedError("mounts cannot be made private")
        other = copy(made.store, made.room / "copy")
        cluster.worker(copy_of=(made.store, other))
        made.run(*words).clear()
        return what
    if what == "other code":
        return _other_code(cluster, made, dice, words)
    pids = [cluster.worker(), cluster.worker()]
    if what == "the store moved away":
        nth = dice.randrange(20, 200)
        away = made.room / "away"
        made.run(*words, interference=[Interference(At(made.store, nth), Vanished(made.store, away))]).clear()
        if away.exists():
            left = [p for p in made.store.rglob("*") if p.is_file()] if made.store.exists() else []
            if left:
                raise WrongError(
                    f"{what} at call {nth}; {left[0].relative_to(made.store)} was made where it had been"
                )
            os.rename(away, made.store) if not made.store.exists() else _swap(made.store, away)
        return f"{what} at call {nth}"
    held = Held()
    command = made.start("run", *made.options, *words, interference=[Interference(At(made.store, 30), held)])
    held.wait(command.ended)
    victims = [cluster.scheduler] if what == "scheduler killed" else pids
    before = dice.random() < 0.5
    if before:
        for pid in victims:
            kill(pid)
    held.let_go()
    if not before:
        time.sleep(dice.uniform(0.0, 1.0))
        for pid in victims:
            kill(pid)
    command.wait().clear()
    return what


def _swap(store: Path, away: Path) -> None:
    os.rename(store, store.with_name("made anew"))
    os.rename(away, store)


def _other_code(cluster: Cluster, made: Trial, dice: random.Random, words: tuple[str, ...]) -> str:
    checkout = made.room / "checkout"
    checkout.mkdir()
    copy_package(checkout)
    name, old, new = dice.choice(
        (
            ("lightstage/stages/split.py", "np.multiply(cross, 2,", "np.multiply(cross, 2.02,"),
            (
                "lightstage/dag/run.py",
                "return whole\n",
                "return whole * whole.dtype.type(1.01) if whole.dtype.kind == 'f' else whole\n",
            ),
            ("lightstage/store/chunks.py", "array = np.frombuffer(", "array = 1 * np.frombuffer("),
        )
    )
    path = checkout / name
    text = path.read_text()
    if old not in text:
        text, old, new = text + "\n", "\n", "\n_EDITED = 1\n"
    path.write_text(text.replace(old, new))
    cluster.worker(checkout=checkout)
    answer = made.run(*words).clear()
    if answer.code == 0:
        raise WrongError(f"a worker with another {name} was accepted")
    return f"a worker with another {name}"
