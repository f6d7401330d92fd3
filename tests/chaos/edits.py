"""One of each thing that can change an answer is edited, and the next run computes what it must and nothing else.

Source files are edited in a copy of the checkout, one drawn from all that a walk of its folders finds; what a
stage's code is, is found here by following imports from file to file, apart from how the engine does it. An
edit that changes no number must cost the nodes whose code it is in and no other; one that changes numbers must
give what a new store gives.
"""

import ast
import importlib
import random
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from tests.chaos.bench import REPOSITORY, Answer, Bench, Trial, item
from tests.chaos.outcome import WrongError
from tests.package import copy_package
from tests.scenes import write_capture

KINDS = ("a source file", "the pipeline", "an item", "the session", "an option", "a library")
TRIALS = 42
STAGES = {name: f"lightstage.stages.{name}" for name in ("register", "split", "stack", "align", "normals")}
DARK = {"dark": "lightstage.stages.calibration.dark"}
ALL = frozenset(STAGES)
DISTRIBUTIONS = {"numpy": "numpy", "scipy": "scipy", "colour": "colour-science", "numba": "numba"}


def kind(seed: int) -> str:
    """The row of the table."""
    return KINDS[0] if seed % 3 == 0 else KINDS[1 + seed // 3 % (len(KINDS) - 1)]


def trial(made: Trial) -> None:
    """One edit."""
    dice = random.Random(f"edits {made.seed}")
    made.take_store(made.bench.once("edited", _two_sessions))
    {
        "a source file": _source,
        "the pipeline": _pipeline,
        "an item": _item,
        "the session": _session,
        "an option": _option,
        "a library": _library,
    }[kind(made.seed)](made, dice)


def _two_sessions(room: Path, bench: Bench) -> None:
    """The tiny capture, run, and a dark target, whose node stands in the pipeline of calibration."""
    other = Trial(bench, room, 0)
    other.take_store()
    generator = np.random.default_rng(3)
    pictures = {(i, 0, "cross"): generator.integers(8, 16, (12, 16)).astype(np.uint16) for i in range(4)}
    folder = write_capture(room / "darkness", pictures, illumination=["O"] * 4, target={"kind": "dark"})
    other.command("import", folder).done()
    _dark(other).done()


def _dark(made: Trial, **more: Any) -> Answer:
    pipeline = str(REPOSITORY / "calibration.yaml")
    return made.command("run", "dark", "--session", "darkness", "--pipeline", pipeline, "--json", **more)


def _computed(answer: Answer) -> set[str]:
    return {name for name, node in answer.done().json["nodes"].items() if node["computed"]}


def _expect(made: Trial, said: str, found: set[str], must: set[str], may: set[str] | None = None) -> None:
    if must - found:
        raise WrongError(f"{said}: {min(must - found)} was not computed again")
    if found - (must if may is None else may):
        raise WrongError(f"{said}: {min(found - (must if may is None else may))} was computed again for nothing")


def _source(made: Trial, dice: random.Random) -> None:
    checkout = made.room / "checkout"
    checkout.mkdir()
    copy_package(checkout)
    folders: dict[Path, list[Path]] = {}
    for path in sorted(checkout.rglob("*.py")):
        folders.setdefault(path.parent, []).append(path)
    path = dice.choice(folders[dice.choice(sorted(folders))])
    if dice.random() < 0.4:  # one that surely counts
        counted = sorted(_closure(dice.choice([*STAGES.values(), *DARK.values()])))
        path = checkout / _file(dice.choice(counted)).relative_to(REPOSITORY / "src")
    name = path.relative_to(checkout).as_posix()
    kinds = ("a constant", "a comment")
    what = dice.choice((kinds[0], *kinds))
    path.write_text(path.read_text() + {"a constant": "\n_EDITED = 1\n", "a comment": "\n# edited\n"}[what])
    said = f"{what} in {name}"
    module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    code = {node for node, stage in {**STAGES, **DARK}.items() if module in _closure(stage)}
    must = {node for node in code if module in _closure(({**STAGES, **DARK})[node], packages=False)}
    if what == "a comment":
        code, must = set(), set()
    found = _computed(made.run("--json", checkout=checkout)) | _computed(_dark(made, checkout=checkout))
    _expect(made, said, found, must, code)
    made.check_exports(made.bench.truth().usual, said, all_of_them=True)


_COUNTED = tuple(f"lightstage.{name}." for name in ("stages", "kernels", "hw"))


def _file(module: str) -> Path:
    plain = REPOSITORY / "src" / f"{module.replace('.', '/')}.py"
    return plain if plain.is_file() else plain.with_suffix("") / "__init__.py"


def _closure(module: str, *, packages: bool = True) -> set[str]:
    """The modules of stages, kernels and hw that a stage's module and the functions that it names import, through
    others too.

    Args:
        packages: with the `__init__` of each one's folders, which an import executes.
    """
    found: set[str] = set()
    waiting = [module, *importlib.import_module(module).STAGE.modules]
    while waiting:
        name = waiting.pop()
        if name in found or not _file(name).is_file():
            continue
        found.add(name)
        if packages:
            waiting += [name.rsplit(".", i)[0] for i in range(1, name.count(".") + 1)]
        for node in ast.walk(ast.parse(_file(name).read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = [f"{node.module}.{alias.name}" for alias in node.names]
                names = [n for n in inner if _file(n).is_file()] or [node.module]
            waiting += [n for n in names if n.startswith(_COUNTED)]
    return found


def _pipeline(made: Trial, dice: random.Random) -> None:
    text = made.bench.pipeline.read_text()
    old, new, must = dice.choice(
        (
            ("from: align}", "from: align, params: {method: ratio}}", set()),  # of another request
            ("from: align}", "from: align, params: {method: auto}}", set()),
            ("from: capture}", "from: capture, params: {flat_smoothing_percent: 7}}", {"register"}),
            ("stages:", "# a comment\nstages:", set()),
            ("  normals:  {", "  again:    {uses: normals, from: align}\n  normals:  {", set()),
            ("  normals:  {", "  bases:    {", set()),
            ("from: align}", "from: align, params: {method: minimal}}", {"normals"}),
        )
    )
    file = made.room / "pipeline.yaml"
    file.write_text(text.replace(old, new))
    answer = made.command("run", "--session", "ball", "--pipeline", file, "--json")
    _expect(
        made, f"the pipeline's {old.strip()!r} -> {new.strip()!r}", _computed(answer), must, must | _below(must)
    )


def _below(nodes: set[str]) -> set[str]:
    order = list(STAGES)
    return set(order[min((order.index(n) for n in nodes), default=len(order)) :])


def _anew(made: Trial, said: str, folder: Path) -> None:
    """What the edited store gives is what a new one gives."""
    found = made.exported(truth=True)
    other = Trial(made.bench, made.room / "anew", made.seed)
    other.command("import", folder).done()
    other.run().done()
    for name, values in other.exported(truth=True).items():
        if not np.array_equal(found[name], values, equal_nan=values.dtype.kind == "f"):
            raise WrongError(f"{said}: {name} is not what a new store gives")


def _item(made: Trial, dice: random.Random) -> None:
    folder = made.take_capture()
    name, must = dice.choice(
        (("homography", "register"), ("bands", "stack"), ("dark", "register"), ("flat", "register"))
    )
    file = folder / "calibration" / f"{name}.yaml"
    what = dice.choice(("numbers", "numbers", "notes", "picture"))
    if what == "picture" and name in ("dark", "flat"):
        path = folder / "calibration" / f"{name}_CAM1.png"
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        pixels[3:9, 4:12] += 60
        assert cv2.imwrite(str(path), pixels)
    elif what == "notes":
        file.write_text(f"# edited\n{yaml.safe_dump({**item(name), 'residuals': 0.5})}")
    else:
        file.write_text(yaml.safe_dump(item(name, 1)))
    said = f"{what} of {name}"
    made.command("import", folder).done()
    nodes = set() if what == "notes" else {must}
    _expect(made, said, _computed(made.run("--json")), nodes, _below(nodes))
    _anew(made, said, folder)


def _session(made: Trial, dice: random.Random) -> None:
    folder = made.take_capture()
    description = yaml.safe_load((folder / "capture.yaml").read_text())
    what = dice.choice(("bits", "a picture", "a date", "a rotation", "a camera's name"))
    must: set[str] = {"register"}
    if what == "bits":
        description["bits"] = 12
        must = set()  # whoever reads the white level
    elif what == "a picture":
        name = dice.choice(sorted(p.name for p in folder.glob("*.png")))
        pixels = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
        pixels[6:12, 6:14] += 9
        assert cv2.imwrite(str(folder / name), pixels)
    elif what == "a date":
        description["captured"] = "2020-01-02T03:04:05"
        must = set()
    elif what == "a rotation":
        description["mount"] = {"CAM0": {"rotate": 180, "mirror": False}, "CAM1": {"rotate": 180, "mirror": False}}
    else:
        description["frames"][1]["illumination"] = "X"
        must = set()
    (folder / "capture.yaml").write_text(yaml.safe_dump(description, sort_keys=False))
    said = f"{what} of the session"
    made.command("import", folder).done()
    _expect(made, said, _computed(made.run("--json")), must, set() if what == "a date" else set(ALL))
    _anew(made, said, folder)


def _option(made: Trial, dice: random.Random) -> None:
    words, must = dice.choice(
        (
            (["--set", "normals.method=minimal"], {"normals"}),
            (["--set", "normals.method=ratio"], set()),
            (["--set", "register.flat_smoothing_percent=7"], {"register"}),
            (["--frames", "0:3"], set()),
            (["--calibration", f"homography={made.bench.items / 'homography.yaml'}"], {"register"}),
            (["--calibration", f"bands={made.bench.items / 'bands.yaml'}"], {"stack"}),
            (["--calibration", f"bands={made.bench.capture / 'calibration' / 'bands.yaml'}"], set()),
        )
    )
    said = " ".join(words)
    _expect(made, said, _computed(made.run("--json", *words)), must, must | _below(must))
    _expect(made, f"{said} and back", _computed(made.run("--json")), set())
    made.check_exports(made.bench.truth().usual, said, all_of_them=True)


def _library(made: Trial, dice: random.Random) -> None:
    name = dice.choice(sorted(DISTRIBUTIONS))
    folder = made.room / "newer" / f"{DISTRIBUTIONS[name].replace('-', '_')}-99.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {DISTRIBUTIONS[name]}\nVersion: 99.0\n")

    def newer() -> None:
        sys.path.insert(0, str(folder.parent))

    using = {node for node, stage in STAGES.items() if any(name in _libraries(m) for m in _closure(stage))}
    may = set(using)
    if name == "scipy":  # numba's linear algebra calls it
        may |= {node for node, stage in STAGES.items() if any("numba" in _libraries(m) for m in _closure(stage))}
    answer = made.run("--json", checkout=REPOSITORY / "src", before=newer)
    _expect(made, f"another version of {name}", _computed(answer), using, may)


def _libraries(module: str) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(_file(module).read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found
