"""What it costs to ask again: lightstage beside doit, Snakemake, DVC and redun, and beside `import numpy`.

Every tool has an equivalent pipeline of 50 input files, a step for each, and one sum of all, written as its
documentation recommends. Ours is the default pipeline on a capture of one light at a time: 50 pictures of 64 x 48 from
the virtual rig, whose one normal map is made of all of them. Whole processes, in turn, medians of several rounds:

- start: the version is asked for;
- nothing changed: the finished pipeline is run again;
- one input changed: a picture has other noise (ours: imported again, and run: two processes);
- a parameter of the step changed, and all outputs of the step are equal.

The others are installed from the package index into a virtual environment of their own in a temporary folder; one that
cannot be is named in the table.

    nice python -m benchmarks.peers [--rounds 7]
"""

import argparse
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np

from benchmarks.growth import Cost, lightstage, process
from lightstage.hw.virtual_rig import Shot, capture

INPUTS = 50
VALUES = 64 * 48
LARGEST = 1000
"""Of the values in an input: a limit from here on changes none of them."""
STEP = '''"""min(value, limit) of every line of a file, or the sum over files."""
import sys


def step(source, target, limit):
    with open(source) as lines, open(target, "w") as out:
        out.writelines(f"{min(int(line), limit)}\\n" for line in lines)


def total(sources, target):
    result = 0
    for source in sources:
        with open(source) as lines:
            result += sum(int(line) for line in lines)
    with open(target, "w") as out:
        out.write(f"{result}\\n")


if __name__ == "__main__":
    if sys.argv[1] == "step":
        step(sys.argv[2], sys.argv[3], int(sys.argv[4]))
    else:
        total(sys.argv[3:], sys.argv[2])
'''
DOIT = f"""import json
from doit.tools import config_changed
from numbers_step import step, total

LIMIT = json.load(open("params.json"))["limit"]
OUT = [f"out/{{i}}.txt" for i in range({INPUTS})]


def task_step():
    for i in range({INPUTS}):
        yield {{
            "name": str(i),
            "actions": [(step, [f"in/{{i}}.txt", OUT[i], LIMIT])],
            "file_dep": [f"in/{{i}}.txt"],
            "targets": [OUT[i]],
            "uptodate": [config_changed({{"limit": LIMIT}})],
        }}


def task_total():
    return {{"actions": [(total, [OUT, "total.txt"])], "file_dep": OUT, "targets": ["total.txt"]}}
"""
SNAKEMAKE = f"""configfile: "params.json"
I = range({INPUTS})

rule all:
    input: "total.txt"

rule step:
    input: "in/{{i}}.txt"
    output: "out/{{i}}.txt"
    params: limit=config["limit"]
    shell: "python numbers_step.py step {{input}} {{output}} {{params.limit}}"

rule total:
    input: expand("out/{{i}}.txt", i=I)
    output: "total.txt"
    shell: "python numbers_step.py total {{output}} {{input}}"
"""
DVC = f"""vars: [params.json]
stages:
  step:
    foreach: [{", ".join(map(str, range(INPUTS)))}]
    do:
      cmd: python numbers_step.py step in/${{item}}.txt out/${{item}}.txt ${{limit}}
      deps: ["in/${{item}}.txt"]
      params: [params.json: [limit]]
      outs: ["out/${{item}}.txt"]
  total:
    cmd: python numbers_step.py total total.txt {" ".join(f"out/{i}.txt" for i in range(INPUTS))}
    deps: [{", ".join(f"out/{i}.txt" for i in range(INPUTS))}]
    outs: [total.txt]
"""
REDUN = f"""import json
from redun import File, task
import numbers_step

redun_namespace = "peers"


@task()
def step(source: File, i: int, limit: int) -> File:
    numbers_step.step(source.path, f"out/{{i}}.txt", limit)
    return File(f"out/{{i}}.txt")


@task()
def total(sources: list[File]) -> File:
    numbers_step.total([source.path for source in sources], "total.txt")
    return File("total.txt")


@task()
def main(limit: int) -> File:
    return total([step(File(f"in/{{i}}.txt"), i, limit) for i in range({INPUTS})])
"""


@dataclass
class Tool:
    """One that is compared; each of its measures is a list of commands, run one after the other."""

    name: str
    start: list[str | Path]
    run: Callable[[int], list[list[str | Path]]]
    """Commands for a parameter of the step."""
    change: Callable[[int], list[list[str | Path]]]
    """Change an input, and say what has to be run before `run`."""
    folder: Path
    costs: dict[str, list[Cost]] = field(default_factory=dict)

    def measure(self, what: str, commands: Sequence[list[str | Path]]) -> None:
        """Run and keep what it took."""
        spent = [process(command, self.folder) for command in commands]
        whole = Cost(sum(c.processor_s for c in spent), sum(c.wall_s for c in spent), max(c.peak_mb for c in spent))
        self.costs.setdefault(what, []).append(whole)


def numbers(path: Path, seed: int) -> None:
    """An input of the others."""
    values = np.random.default_rng(seed).integers(0, LARGEST, VALUES)
    path.write_text("".join(f"{value}\n" for value in values))


def ours(work: Path) -> Tool:
    """Ours, with its pictures."""
    folder = capture(
        Shot(
            session="lights",
            width=64,
            height=48,
            bands_nm=(0,),
            sequence=tuple(f"L{i:02d}" for i in range(INPUTS)),
            frequency=4,
        ),
        work / "lights",
    )
    store = work / "store"
    picture = sorted(folder.glob("*_CAM1.png"))[0]
    original = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)

    def change(seed: int) -> list[list[str | Path]]:
        noise = np.random.default_rng(seed).integers(0, 2, original.shape, dtype=original.dtype)
        cv2.imwrite(str(picture), original + noise)
        return [lightstage(store, "import", folder)]

    def run(parameter: int) -> list[list[str | Path]]:
        # without a flat item nothing is smoothed
        setting = f"register.flat_smoothing_percent={1 + parameter / 100}"
        return [lightstage(store, "run", "--session", "lights", "--set", setting)]

    process(lightstage(store, "import", folder))
    return Tool(f"lightstage {version('lightstage')}", lightstage(store, "--version"), run, change, work)


def others(work: Path) -> tuple[list[Tool], list[str]]:
    """The others, installed, and sentences on those that cannot be."""
    environment = work / "environment"
    uv = shutil.which("uv")
    python = environment / "bin" / "python"
    create = [uv, "venv", "-q"] if uv else [sys.executable, "-m", "venv"]
    if uv:
        create += ["--python", sys.executable]
    subprocess.run([*create, environment], check=True)
    install = [uv, "pip", "install", "-q", "--python", python] if uv else [python, "-m", "pip", "install", "-q"]
    files = {"doit": "dodo.py", "snakemake": "Snakefile", "dvc": "dvc.yaml", "redun": "workflow.py"}
    texts = {"doit": DOIT, "snakemake": SNAKEMAKE, "dvc": DVC, "redun": REDUN}
    tools, missing = [], []
    for name, text in texts.items():
        if subprocess.run([*install, name], check=False).returncode:
            missing.append(name)
            continue
        folder = work / name
        for part in ("in", "out"):
            (folder / part).mkdir(parents=True)
        (folder / files[name]).write_text(text)
        (folder / "numbers_step.py").write_text(STEP)
        for i in range(INPUTS):
            numbers(folder / "in" / f"{i}.txt", i)
        code = f"from importlib.metadata import version; print(version({name!r}))"
        number = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
        tools.append(_tool(name, number, folder, environment / "bin"))
    return tools, missing


def _tool(name: str, number: str, folder: Path, programs: Path) -> Tool:
    program = programs / name
    options: dict[str, list[str]] = {
        "doit": ["-v0"],
        "snakemake": ["--cores", "2", "--quiet", "all"],
        "dvc": ["repro", "-q"],
        "redun": ["run", "workflow.py", "main"],
    }
    if name == "dvc":
        process([program, "init", "-q", "--no-scm"], folder)

    def run(parameter: int) -> list[list[str | Path]]:
        limit = LARGEST + parameter
        (folder / "params.json").write_text(f'{{"limit": {limit}}}')
        return [[program, *options[name], *(["--limit", str(limit)] if name == "redun" else [])]]

    def change(seed: int) -> list[list[str | Path]]:
        numbers(folder / "in" / "0.txt", seed)
        return []

    return Tool(f"{name} {number}", [program, "--version"], run, change, folder)


def measure(tools: Sequence[Tool], rounds: int) -> list[float]:
    """All of it, in turn; returns the processor seconds of `import numpy`."""
    numpy = []
    for tool in tools:
        for command in tool.run(0):
            process(command, tool.folder)
    for turn in range(1, rounds + 1):
        numpy.append(process([sys.executable, "-c", "import numpy"]).processor_s)
        for tool in tools:
            tool.measure("start", [tool.start])
            tool.measure("nothing changed", tool.run(turn - 1))
            tool.measure("one input changed", [*tool.change(INPUTS + turn), *tool.run(turn - 1)])
            tool.measure("parameter changed, equal output", tool.run(turn))
    return numpy


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as room:
        work = Path(room)
        os.environ |= {"DVC_NO_ANALYTICS": "1", "PYTHONDONTWRITEBYTECODE": ""}
        tools, missing = others(work)
        os.environ["PATH"] = f"{work / 'environment' / 'bin'}{os.pathsep}{os.environ['PATH']}"
        tools.insert(0, ours(work))
        numpy = statistics.median(measure(tools, options.rounds))
    print(f"{platform.platform()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    print(f"`import numpy` {version('numpy')}: {numpy:.3f} s; medians of {options.rounds}: processor s / wall s")
    measures = list(tools[0].costs)
    print(f"| tool | {' | '.join(measures)} |\n|---|{'---|' * len(measures)}")
    for tool in tools:
        cells = []
        for what in measures:
            cost, base = (statistics.median(c.processor_s for c in t.costs[what]) for t in (tool, tools[0]))
            wall = statistics.median(c.wall_s for c in tool.costs[what])
            cells.append(f"{cost:.2f} / {wall:.2f} ({cost / base:.1f} x ours)")
        print(f"| {tool.name} | {' | '.join(cells)} |")
    for name in missing:
        print(f"| {name} | could not be installed |{' |' * (len(measures) - 1)}")
    print(f"a cached run of ours: {statistics.median(_cached(tools[0])) / numpy:.2f} x `import numpy`")


def _cached(tool: Tool) -> list[float]:
    return [cost.processor_s for cost in tool.costs["nothing changed"]]


if __name__ == "__main__":
    main()
