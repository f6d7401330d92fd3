"""Ways of running that must give the same bits, and changes of files that must cost only what they must.

Threads, local processes and a cluster compute a new session; every file of the results must be the same.
Pictures that are touched, saved anew with other compression or moved cost nothing, and two that are exchanged
cost two frames.
"""

import os
import random
import shutil
from collections.abc import Callable

import cv2

from tests.chaos.bench import Answer, Trial, results
from tests.chaos.cluster import Cluster
from tests.chaos.outcome import WrongError
from tests.scenes import STATIC

KINDS = (
    "touched",
    "exchanged pictures",
    "other compression",
    "a moved archive",
    "a moved store",
    "threads and processes",
    "in another order",
    "threads and a cluster",
)
TRIALS = 24


def kind(seed: int) -> str:
    """The row of the table."""
    return KINDS[seed % len(KINDS)]


def trial(made: Trial) -> None:
    """One comparison."""
    dice = random.Random(f"equivalence {made.seed}")
    what = kind(made.seed)
    if what in ("threads and processes", "threads and a cluster", "in another order"):
        made.take_store(made.bench.imported)
        if what == "threads and processes":
            made.run("--workers", "2").done()
        elif what == "threads and a cluster":
            with Cluster(made) as cluster:
                cluster.worker()
                cluster.worker()
                made.run("--scheduler", cluster.address).done()
        else:
            first = dice.randrange(len(STATIC))
            made.run("--frames", f"{first}:{first + 1}").done()
            made.run("split").done()
            made.run().done()
        if results(made.store) != results(made.bench.base):
            raise WrongError(f"{what}: other bits than threads give")
        made.command("verify").done()
        return
    made.take_store()
    folder = made.take_capture()
    changes: dict[str, Callable[[], dict[str, int]]] = {
        "touched": lambda: _touch(made, dice),
        "exchanged pictures": lambda: _exchange(made, dice),
        "other compression": lambda: _compress(made, dice),
        "a moved archive": dict,
        "a moved store": lambda: _move(made),
    }
    expected = changes[what]()
    made.command("import", folder).done()
    found = _computed(made.run("--json"))
    if found != expected:
        raise WrongError(f"{what}: computed {found} blocks, expected {expected}")
    if not expected:
        made.check_exports(made.bench.truth().usual, what, all_of_them=True)


def _computed(answer: Answer) -> dict[str, int]:
    return {name: node["computed"] for name, node in answer.done().json["nodes"].items() if node["computed"]}


def _touch(made: Trial, dice: random.Random) -> dict[str, int]:
    for path in (made.room / "ball").rglob("*"):
        if dice.random() < 0.5:
            os.utime(path, (dice.randrange(10**9), dice.randrange(2 * 10**9)))
    return {}


def _exchange(made: Trial, dice: random.Random) -> dict[str, int]:
    first, second = dice.sample(range(len(STATIC)), 2)
    paths = [made.room / "ball" / f"{i:04d}_{STATIC[i]}_576nm_CAM1.png" for i in (first, second)]
    spare = made.room / "spare.png"
    os.rename(paths[0], spare)
    os.rename(paths[1], paths[0])
    os.rename(spare, paths[1])
    return {"register": 2, "split": 2, "stack": 2, "align": 1, "normals": 1}


def _compress(made: Trial, dice: random.Random) -> dict[str, int]:
    for path in sorted((made.room / "ball").glob("*.png")):
        if dice.random() < 0.5:
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert cv2.imwrite(str(path), pixels, [cv2.IMWRITE_PNG_COMPRESSION, dice.choice((0, 9))])
    return {}


def _move(made: Trial) -> dict[str, int]:
    elsewhere = made.room / "elsewhere"
    shutil.move(made.store, elsewhere)
    made.store = elsewhere
    return {}
