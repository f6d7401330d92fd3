"""Two commands at once, the first held at one of its calls until the second is done.

The call is drawn from all that the first command makes below the store, so that the second may come before,
between or after any two of its steps; nothing is left to luck but the order of threads. Each command is done or
ends with one sentence. Wrong is a binding that was said to be made and is not there, a result that is not what
the session as it then stands gives, a picture of before an import after it, and a `verify` that finds anything
afterwards.
"""

import json
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.chaos.bench import Answer, Bench, Trial, copy, item
from tests.chaos.interference import At, Counted, Held, Interference
from tests.chaos.outcome import WrongError

PAIRS = (
    ("run", "run"),
    ("run", "gc"),
    ("gc", "run"),
    ("run", "import"),
    ("import", "verify"),
    ("verify", "import"),
    ("use", "use of another kind"),
    ("use", "import"),
    ("import", "use"),
    ("run", "use and use again"),
    ("gc", "verify"),
    ("verify", "gc"),
    ("verify", "run"),
    ("run", "remove"),
    ("import", "gc"),
    ("gc", "import"),
    ("run", "another request"),
    ("import", "import"),
)
TRIALS = 4 * len(PAIRS)
CHANGED = "0004_Xc_576nm_CAM1.png"


def kind(seed: int) -> str:
    """The row of the table."""
    first, second = PAIRS[seed % len(PAIRS)]
    return f"{first} / {second}"


def trial(made: Trial) -> None:
    """One pair."""
    dice = random.Random(f"races {made.seed}")
    first, second = PAIRS[made.seed % len(PAIRS)]
    _prepare(made, first)
    (words,) = _words(made, first)
    events = _events(made, first)
    # half of them at a change, because between a look and a change is where it hurts
    changes = [i for i, event in enumerate(events) if not event.startswith(("open ", "os.listdir", "os.scandir"))]
    nth = 1 + (dice.choice(changes) if changes and dice.random() < 0.5 else dice.randrange(len(events)))
    held = Held()
    command = made.start(*words, interference=[Interference(At(made.store, nth), held)])
    where = held.wait(command.ended)
    said = f"{first} held at call {nth} of {len(events)} ({_short(where, made.store)}), {second}"
    others: list[Answer] = []
    try:
        for other in _words(made, second):
            others.append(made.command(*other).clear())
    finally:
        held.let_go()
    answer = command.wait().clear()
    _check(made, said, first, second, answer, others)


def _short(where: str | None, store: Path) -> str:
    return "not reached" if where is None else where.replace(f"{store}/", "")


def _prepare(made: Trial, first: str) -> None:
    """A store with something that a gc frees and results that a run may take up, and a folder with one new
    picture."""
    fresh = first == "run" and made.seed // len(PAIRS) % 2 == 1
    base = made.bench.imported
    if not fresh:
        base = made.bench.once("raced", _raced)
    made.take_store(base)
    folder = made.take_capture()
    changed = cv2.imread(str(folder / CHANGED), cv2.IMREAD_UNCHANGED)
    assert cv2.imwrite(str(folder / CHANGED), changed + 5)


def _raced(room: Path, bench: Bench) -> None:
    other = Trial(bench, room, 0)
    other.take_store()
    other.run("--set", "normals.method=minimal").done()
    other.run("--set", "register.flat_smoothing_percent=3").done()


def _words(made: Trial, name: str) -> Sequence[tuple[Any, ...]]:
    bind = ("calibration", "use")
    to = ("--session", "ball")
    return {
        "run": [("run", *made.options)],
        "another request": [("run", *made.options, "--set", "normals.method=ratio")],
        "gc": [("gc", "--grace", "0s")],
        "verify": [("verify",)],
        "import": [("import", made.room / "ball")],
        "use": [(*bind, made.bench.items / "homography.yaml", *to)],
        "use of another kind": [(*bind, made.bench.items / "bands.yaml", *to)],
        "use and use again": [
            (*bind, made.bench.items / "homography.yaml", *to),
            (*bind, made.bench.capture / "calibration" / "homography.yaml", *to),
        ],
        "remove": [("sessions", "remove", "ball")],
    }[name]


def _events(made: Trial, first: str) -> list[str]:
    """What a command does below its store when nobody disturbs it; listed once, in a copy."""
    fresh = not (made.store / "results").is_dir()

    def listed(room: Path, bench: Bench) -> None:
        other = Trial(bench, room, made.seed)
        other.take_store(made.store)
        copy(made.room / "ball", room / "ball")
        (room / "log").touch()
        (words,) = _words(other, first)
        other.command(*words, interference=[Interference(At(other.store), Counted(room / "log"))]).done()

    room = made.bench.once(f"events of {first}{' in a new store' if fresh else ''}", listed)
    return room.with_name("log").read_text().splitlines()


def _check(made: Trial, said: str, first: str, second: str, answer: Answer, others: list[Answer]) -> None:
    done = {first: answer.code == 0, second: all(other.code == 0 for other in others)}
    said += f" (exits {answer.code}, {', '.join(str(other.code) for other in others)})"
    session = made.store / "sessions" / "ball" / "session.json"
    if session.is_file():
        bound = json.loads(session.read_bytes())
        bound = bound.get("items") or next(
            v["items"] for v in bound.values() if isinstance(v, dict) and "items" in v
        )
        for name, kind_of, version in (("use", "homography", 1), ("use of another kind", "bands", 1)):
            if done.get(name):
                _check_binding(made, said, bound, kind_of, version)
        if done.get("import") and first != second and "remove" not in done:
            _check_import(made, said)
    elif "remove" not in done:
        raise WrongError(f"{said}: the session is gone")
    if "remove" not in done and first in ("run", "gc", "verify") and done[first]:
        made.check_exports(_truth(made), said, nodes=("capture",)) if done.get("import") else None
    # then the store as it stands must give what a new store gives
    if "remove" in done:
        made.command("import", made.room / "ball").done()
    made.run().done()
    if "use and use again" in done and (bad := _differs(made, made.bench.truth().usual)):
        raise WrongError(f"{said}; the run after it gives another {bad}")
    bound_now = made.command("calibration", "list", "--session", "ball", "--json").done().json["items"]
    _check_against_new(made, said, [row["item"] for row in bound_now])
    made.command("verify").done()


def _check_binding(made: Trial, said: str, bound: dict[str, str], kind_of: str, version: int) -> None:
    rows = made.command("calibration", "show", f"{kind_of}-{bound[kind_of][:12]}", "--json").done().json
    wanted = item(kind_of, version)
    key = "matrix" if kind_of == "homography" else "bands"
    found = rows["values"][key]
    if kind_of == "bands":
        found, expected = found[0]["exposure"], wanted[key][0]["exposure"]
    else:
        expected = wanted[key]
    if not np.allclose(found, expected):
        raise WrongError(f"{said}: `calibration use` of {kind_of} said done, and it is not bound")


def _check_import(made: Trial, said: str) -> None:
    found = made.exported(("capture",), truth=True)
    wanted = cv2.imread(str(made.room / "ball" / CHANGED), cv2.IMREAD_UNCHANGED)
    name = next(n for n in found if "0004_Xc" in n and "cross" in n)
    if not np.array_equal(found[name], wanted):
        raise WrongError(f"{said}: the import said done, and the raw picture is the old one")


def _truth(made: Trial) -> dict[str, NDArray[Any]]:
    truth = dict(made.bench.truth().usual)
    name = next(n for n in truth if n.startswith("capture/") and "0004_Xc" in n and "cross" in n)
    truth[name] = cv2.imread(str(made.room / "ball" / CHANGED), cv2.IMREAD_UNCHANGED)
    return truth


def _differs(made: Trial, truth: dict[str, NDArray[Any]]) -> str | None:
    found = made.exported(("register", "normals"), truth=True)
    return next(
        (name for name, values in found.items() if not np.array_equal(values, truth[name], equal_nan=True)), None
    )


def _check_against_new(made: Trial, said: str, bound: list[str]) -> None:
    """What the store gives is what a new store gives for the same pictures and items."""
    found = made.exported(truth=True)
    old = np.array_equal(_cross(found), _cross(made.bench.truth().usual))

    def anew(room: Path, bench: Bench) -> None:
        other = Trial(bench, room, made.seed)
        other.command("import", bench.capture if old else made.room / "ball").done()
        for name in bound:
            kind_of = name.split("-")[0]
            for folder in (bench.items, bench.capture / "calibration"):
                words = ("calibration", "use", folder / f"{kind_of}.yaml", "--session", "ball", "--json")
                if other.command(*words).done().json["item"] == name:
                    break
        other.run().done()
        np.savez(room / "values.npz", **other.exported(truth=True))

    room = made.bench.once(f"anew {'old' if old else 'new'} {' '.join(sorted(bound))}", anew)
    with np.load(room.with_name("values.npz")) as wanted:
        for name, values in wanted.items():
            if not np.array_equal(found[name], values, equal_nan=values.dtype.kind == "f"):
                raise WrongError(f"{said}; {name} is not what a new store gives for the same session")


def _cross(values: dict[str, NDArray[Any]] | Any) -> NDArray[Any]:
    return next(v for n, v in values.items() if n.startswith("capture/") and "0004_Xc" in n and "cross" in n)
