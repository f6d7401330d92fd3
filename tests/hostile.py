"""A seeded stream of odd and hostile requests: user files with a value, a key or bytes changed, and odd options.

    python -m tests.hostile --seed 1 --trials 500

runs them in this process and prints every one that is not answered as it should be: exit code 0, 1 or 2, no
sentence that begins with "unexpected", no warning of a library, and within a time.
"""

import argparse
import contextlib
import copy
import io
import random
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from tests.scenes import STATIC, ideal_gradient, sphere_normals, write_capture

ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 7, 65536, 10**14, -(10**14), 10**15),
    *(1.5, -0.0, 1e-300, 1e-12, 1e14, -1e14, 1e15, float("inf"), float("nan")),
    *(
        "",
        " ",
        "x",
        "x" * 300,
        "x" * 5000,
        "a\0b",
        "../x",
        "/etc/passwd",
        "~nobody/x",
        "ü",
        "\x1b[31m",
        "C",
        "{",
        "{}",
    ),
    *(
        "{frame}",
        "{frame:9999999999d}",
        "{camera.__class__}",
        "L" + "9" * 50,
        "dark",
        "str",
        "int",
        "[",
        "1e999",
        ".inf",
    ),
    *([], [[]], {}, {"": 1}, [None], [0] * 50, {"dark": {"dark": 1}}, [[1, 2], [3]], [1e14] * 3, ["a", 1]),
)
TEXTS = (
    *(
        "",
        "\0",
        "a",
        "- a",
        "[" * 3000,
        "{" * 3000,
        "&a [*a]",
        "a: *b",
        "!!python/name:os.system",
        "a: 1\na: 2",
        "\t",
    ),
    *(
        "? [1]: 2",
        "---\n---",
        "a: 1e999",
        "a: " + "9" * 5000,
        "%YAML 9.9\n---\na",
        "'",
        '"\\ud800"',
        "\ufeffa: 1",
        "<<: 1",
    ),
)
WORDS = (
    *(
        "",
        " ",
        "-",
        "--",
        "x",
        "a\udcffb",
        "x" * 5000,
        "../..",
        "/",
        "/dev/null/x",
        ".",
        "~",
        "~nobody/x",
        "0",
        "-1",
    ),
    *(
        "1e999",
        "nan",
        "inf",
        "9" * 5000,
        "1:0",
        "0:1",
        ":",
        "9" * 30 + ":" + "9" * 31,
        "a=b",
        "a.b=c",
        "a.b=[[[[",
        "=",
    ),
    *(
        "X Y Z C",
        "L" + "9" * 40,
        "1,1",
        "0,0,1",
        ",",
        "576,576",
        "99999x99999",
        "lights=nothing.yaml",
        "dark=/",
        "{",
        "%s",
    ),
)


@dataclass(frozen=True)
class Trial:
    """One request, and what it was made of."""

    seed: int
    words: list[str]
    what: str


@dataclass(frozen=True)
class Finding:
    """What a request should not have been answered with."""

    trial: Trial
    said: str


def answered(trial: Trial, *, limit_s: float = 20.0) -> Finding | None:
    """Run a request in this process; None when it is answered as it should be."""
    from lightstage.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    began = time.perf_counter()
    with warnings.catch_warnings(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        warnings.simplefilter("error")
        try:
            code: object = main(trial.words)
        except BaseException as error:  # noqa: BLE001  whatever it is, it should not have come here
            return Finding(trial, f"{type(error).__name__} left main: {error}")
    seconds, said = time.perf_counter() - began, err.getvalue()
    if "lightstage: unexpected" in said or "Traceback" in said or code not in (0, 1, 2):
        return Finding(trial, f"{code}: {said[:600]}")
    if "Warning" in said:
        return Finding(trial, f"a warning: {said[:600]}")
    if code != 0 and not said.strip():
        return Finding(trial, f"{code}, and not a word")
    return Finding(trial, f"{seconds:.0f} s") if seconds > limit_s else None


class Ground:
    """A small store and good files, of which each trial spoils a copy."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.good = root / "good"
        normals, _ = sphere_normals(16)
        pictures = {
            (i, 576.0, p): np.round(20 + level * ideal_gradient(normals, name)).astype(np.uint16)
            for i, name in enumerate(STATIC)
            for p, level in (("parallel", 500), ("cross", 400))
        }
        around = [[700, 0, 200], [-700, 0, 200], [0, 700, 200], [0, -700, 200], [0, 0, 780], [0, 300, -700]]
        lights = [{"id": f"L{i:02d}", "position_mm": place, "power": 1.0} for i, place in enumerate(around)]
        items: dict[str, dict[str, Any]] = {
            "homography": {"from": "CAM0", "to": "CAM1", "matrix": [[1, 0, 0.5], [0, 1, 0], [0, 0, 1]]},
            "lights": {"drive": "ideal", "lights": lights},
            "camera": {
                "size_px": [16, 16],
                "K": [[40, 0, 8], [0, 40, 8], [0, 0, 1]],
                "distortion": [0, 0, 0, 0, 0],
                "world_to_camera": {"R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "t_mm": [0, 0, 890]},
            },
            "bands": {
                "bands": [{"centre_nm": 576, "width_nm": 10, "exposure": 3.0, "curve": [[570, 1], [580, 1]]}]
            },
            "dark": {"images": {c: f"dark_{c}.png" for c in ("CAM0", "CAM1")}, "hot_px": {"CAM0": [[1, 2]]}},
            "flat": {"images": {c: f"flat_{c}.png" for c in ("CAM0", "CAM1")}, "scale": 1.0, "dark_included": True},
            "polarisers": {"lights": [{"id": "L00", "angle_deg": 10.0, "residual": 0.1}]},
        }
        levels = {"dark": 10, "flat": 900}
        write_capture(
            self.good,
            pictures,
            illumination=STATIC,
            items={kind: {"item": kind, **item} for kind, item in items.items()},
            item_pictures={
                f"{k}_{c}.png": np.full((16, 16), v, np.uint16) for k, v in levels.items() for c in ("CAM0", "CAM1")
            },
            mount={"CAM0": {"rotate": 180, "mirror": True}},
            target={"kind": "white", "reflectance": 0.9},
            mask="mask.png",
            intensities={"C": 1.0},
        )
        assert cv2.imwrite(str(self.good / "mask.png"), np.full((16, 16), 255, np.uint8))
        shutil.copy(Path(__file__).parent.parent / "pipeline.yaml", self.good / "pipeline.yaml")
        self.store = root / "store"
        problem = answered(Trial(-1, ["--store", str(self.store), "import", str(self.good)], "the good capture"))
        assert problem is None
        assert (self.store / "sessions" / "good").is_dir()
        self.files = sorted(p.relative_to(self.good) for p in self.good.rglob("*.yaml"))

    def trial(self, seed: int) -> Trial:
        """The request of a seed; its files are written."""
        chance = random.Random(seed)
        if chance.random() < 0.35:
            return Trial(seed, ["--store", str(self.store), *_odd_words(chance)], "options")
        place = self.root / "odd"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(self.good, place)
        file = place / chance.choice(self.files)
        what = spoil(file, chance)
        commands: list[list[str]] = [["import", str(place)]]
        if file.parent.name == "calibration":
            commands = [["calibration", "use", str(file), "--session", "good"], commands[0]]
            commands.append(
                [
                    "run",
                    "--session",
                    "good",
                    "--calibration",
                    f"{file.stem}={file}",
                    "relief",
                    "reflectance",
                    "--dry-run",
                ]
            )
            nodes = chance.choice((["stack", "normals"], ["relief", "reflectance", "shape"]))
            commands.append(["run", "--session", "good", "--calibration", f"{file.stem}={file}", *nodes])
        elif file.name == "capture.yaml":
            commands += [["sequence", "check", str(file)], ["import", str(place), "--session", "other"]]
            commands.append(["calibrate", "dark", "--from", str(place)])
        elif file.name == "pipeline.yaml":
            path = ["--pipeline", str(file)]
            commands = [["graph", *path], ["run", "--dry-run", "--session", "good", *path], ["status", *path]]
            commands.append(["why", "normals", "--session", "good", *path])
        words = chance.choice(commands)
        return Trial(seed, ["--store", str(self.store), *words], f"{file.name}: {what}")


def spoil(file: Path, chance: random.Random) -> str:
    """Change a file; says how."""
    kind = chance.random()
    if kind < 0.1:
        text = chance.choice(TEXTS)
        file.write_bytes(text.encode("utf-8", "surrogatepass"))
        return f"text {text[:40]!r}"
    if kind < 0.3:
        data = bytearray(file.read_bytes())
        for _ in range(chance.randint(1, 4)):
            data[chance.randrange(len(data))] = chance.choice((chance.randrange(256), *b" :{}[],'\"#&*!|>%@-.0e\n"))
        file.write_bytes(bytes(data))
        return "bytes"
    value = yaml.safe_load(file.read_text())
    told = []
    for _ in range(chance.choice((1, 1, 1, 2))):
        path = chance.choice(list(_paths(value)) or [()])
        if not path:  # nothing is left
            break
        told.append(_change(value, path, chance))
    file.write_text(yaml.safe_dump(value, sort_keys=False, allow_unicode=True), encoding="utf-8")
    return ", ".join(told)


def _paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in inside:
        yield (*path, key)
        yield from _paths(inner, (*path, key))


def _change(value: Any, path: tuple[Any, ...], chance: random.Random) -> str:
    for step in path[:-1]:
        value = value[step]
    place, odd = path[-1], copy.deepcopy(chance.choice(ODD))
    how = chance.random()
    if how < 0.15:
        del value[place]
        return f"{path} gone"
    if how < 0.3 and isinstance(value, dict):
        key = chance.choice([word for word in ODD if isinstance(word, str)])
        value[key] = value.pop(place) if chance.random() < 0.5 else odd
        return f"{path[:-1]} has {key[:30]!r}"
    if how < 0.4 and isinstance(value, list):
        value += [copy.deepcopy(value[place])] * chance.choice((1, 30))
        return f"{path} repeated"
    if how < 0.55 and isinstance(value[place], int | float) and not isinstance(value[place], bool):
        value[place] = value[place] * chance.choice((-1, 0, 1e-6, 1e6, 1e12, 0.5, 3))
        return f"{path} = {value[place]}"
    value[place] = odd
    return f"{path} = {str(odd)[:40]!r}"


def _odd_words(chance: random.Random) -> list[str]:
    """A command with odd values for some of its options and arguments."""
    from lightstage.cli.main import build_parser

    def commands(
        parser: argparse.ArgumentParser, words: list[str]
    ) -> Iterator[tuple[list[str], argparse.ArgumentParser]]:
        inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
        if not inner:
            yield words, parser
        for action in inner:
            for name, sub in action.choices.items():
                yield from commands(sub, [*words, name])

    # what would render a head, or play for minutes
    costly = {"demo", "normals", "performance", "skin", "shape", "material", "relight", "stimuli"}
    known = [one for one in commands(build_parser(), []) if one[0] != ["sessions", "remove"]]
    words, parser = chance.choice(known)
    given = list(words)

    def odd(action: argparse.Action) -> str:
        if action.choices and chance.random() < 0.7:
            return str(chance.choice(list(action.choices)))
        usual: dict[str, Callable[[], str]] = {
            "session": lambda: chance.choice(("good", "good", "good", chance.choice(WORDS))),
            "node": lambda: chance.choice(("capture", "normals", "stack", chance.choice(WORDS))),
        }
        return usual.get(action.dest, lambda: chance.choice(WORDS))()

    for action in parser._actions:
        left_out = action.dest in ("debug", "workers", "scheduler", "to", "out", "report", "plot")
        if action.dest == "help" or (left_out and not action.required):
            continue
        if action.option_strings and not action.required and chance.random() < 0.6:
            continue
        count = (
            1
            if action.nargs in (None, "?")
            else action.nargs
            if isinstance(action.nargs, int)
            else chance.randint(1, 2)
        )
        if action.nargs == 0:
            given.append(action.option_strings[-1])
            continue
        values = [odd(action) for _ in range(count)]
        if action.dest in ("to", "out"):
            values = [str(Path(tempfile.gettempdir()) / "lightstage-hostile")]
        if action.option_strings and count == 1:
            given.append(f"{action.option_strings[-1]}={values[0]}")
        else:
            given += [*action.option_strings[-1:], *values]
    if words[0] in costly:
        # refused, or short of a session: the good one is a picture of nothing
        given = [word if word not in ("good",) else "nobody" for word in given]
        if words[0] == "demo" and "--size" not in " ".join(given):
            given.append("--size=40x3")
        if words[0] in ("normals", "performance", "skin", "shape", "material", "relight") and len(given) > 1:
            given.insert(1, "nobody")
    return given


def main() -> int:
    """Run trials; 1 when one is not answered as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, default=200)
    options = parser.parse_args()
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        ground = Ground(Path(folder))
        for seed in range(options.seed, options.seed + options.trials):
            problem = answered(ground.trial(seed))
            if problem is not None:
                found += 1
                words = [word if len(word) < 80 else word[:80] + "..." for word in problem.trial.words[2:]]
                print(f"seed {seed}: {problem.trial.what}\n  {words}\n  {problem.said}", flush=True)
    print(f"{options.trials} requests, {found} not answered as they should be")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
