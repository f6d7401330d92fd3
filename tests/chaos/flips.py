"""Bits, bytes and whole files of a store change, as a bad disk or a careless hand changes them.

The file is chosen over all that a walk of the store finds, each kind of place as likely as another. Then `run`,
`export` and `verify` follow in one of their six orders. Wrong is an export with exit code 0 whose values differ
from the truth, and a `verify` that finds nothing while the changed file lies there. At the end verify, import
and run must make everything right again.
"""

import itertools
import os
import random
import re
from pathlib import Path

from tests.chaos.bench import Trial, files_of, tree
from tests.chaos.outcome import WrongError

TRIALS = 120
KINDS = ("a bit", "a byte", "a truncated file", "two files exchanged", "a file removed", "zeros")


def kind(seed: int) -> str:
    """The row of the table."""
    return KINDS[seed % len(KINDS)]


def places(store: Path) -> dict[str, list[Path]]:
    """The files of a store by kind of place: digests, numbers and names that differ are taken out."""
    found: dict[str, list[Path]] = {}
    for path in files_of(store):
        if path.is_file() and not path.is_symlink():
            place = re.sub(r"[0-9a-f]{6,}", "#", path.relative_to(store).as_posix())
            place = re.sub(r"/[0-9a-f]{2}/", "/#/", re.sub(r"/c\..*", "/c", place))
            found.setdefault(place, []).append(path)
    return found


def trial(made: Trial) -> None:
    """One change, and the three commands after it."""
    dice = random.Random(f"flips {made.seed}")
    truth = made.bench.truth().usual
    store = made.take_store()
    here = places(store)
    place = dice.choice(sorted(here))
    path = dice.choice(here[place])
    what = kind(made.seed)
    change(path, what, dice, here[place])
    changed = tree(store)
    order = dice.choice(list(itertools.permutations(("run", "export", "verify"))))
    said = f"{what} in {path.relative_to(store)}, then"
    for step in order:
        said += f" {step}"
        if step == "run":
            made.run().clear()
        elif step == "export":
            made.check_exports(truth, said)
        else:
            answer = made.command("verify").clear()
            name = path.relative_to(store).as_posix()
            if answer.code == 0 and path.exists() and tree(path.parent)[path.name] == changed.get(name):
                raise WrongError(f"{said}: verify says that all is intact")
    made.check_exports(truth, said)
    if place != "store.json":
        made.healed(truth, said)


def change(path: Path, what: str, dice: random.Random, alike: list[Path]) -> None:
    """Change a file as hardware would: the same inode, so that every link to it changes too."""
    data = bytearray(path.read_bytes())
    if what == "a file removed":
        path.unlink()
        return
    if what == "two files exchanged":
        others = [other for other in alike if other.read_bytes() != data]
        if others:
            other = dice.choice(others)
            spare = path.with_name(f"{path.name}.spare")
            os.rename(path, spare)
            os.rename(other, path)
            os.rename(spare, other)
            return
        what = "a byte"
    at = dice.randrange(len(data)) if data else 0
    if what == "a bit":
        data[at] ^= 1 << dice.randrange(8)
    elif what == "a byte":
        data[at] = (data[at] + dice.randrange(1, 256)) % 256
    elif what == "a truncated file":
        del data[at:]
    else:
        data[at : at + 64] = (
            bytes(len(data[at : at + 64])) if any(data[at : at + 64]) else b"x" * len(data[at : at + 64])
        )
    with open(path, "r+b") as file:
        file.write(data)
        file.truncate()
