"""`python -m tests.chaos`: make the trials, say what did not hold, and write the table."""

import argparse
import contextlib
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

# before anything imports numpy
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from tests.chaos.bench import Bench, Trial, warm  # noqa: E402
from tests.chaos.outcome import Outcome, SkippedError, TrialError, table  # noqa: E402

PARTS = ("flips", "kills", "disks", "races", "edits", "workers", "malformed", "equivalence")
LONGEST_S = 300.0
BEGIN, END = "<!-- make chaos: begin -->", "<!-- make chaos: end -->"


def main(arguments: Sequence[str] | None = None) -> int:
    """Make trials; 0 when all held."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this one (may stand several times)")
    parser.add_argument("--seed", type=int, default=0, help="of the first trial")
    parser.add_argument("--trials", type=int, help="how many of each part (default: as many as the part says)")
    parser.add_argument("--jobs", type=int, default=2, help="trials at once")
    parser.add_argument("--keep", action="store_true", help="keep the rooms of trials that did not hold")
    parser.add_argument("--table", type=Path, help="the Markdown file whose table is written anew")
    options = parser.parse_args(arguments)
    warm()
    began = time.monotonic()
    work = _room()
    outcomes: list[Outcome] = []
    try:
        outcomes = _all_trials(options, Bench(work / "bench"), work)
    finally:
        failed = not outcomes or any(outcome.verdict not in ("held", "skipped") for outcome in outcomes)
        if not (options.keep and failed):
            shutil.rmtree(work, ignore_errors=True)
    made = table(outcomes)
    print(f"\n{made}\n\n{len(outcomes)} trials in {time.monotonic() - began:.0f} s")
    if options.table is not None:
        _write_table(options.table, made)
    return int(failed)


def _room() -> Path:
    """The same folder each time, if it is free: its name is in sessions, and so in the order of their records."""
    try:
        Path(tempfile.gettempdir(), "lightstage-chaos").mkdir()
    except FileExistsError:
        return Path(tempfile.mkdtemp(prefix="lightstage-chaos-"))
    return Path(tempfile.gettempdir(), "lightstage-chaos")


def _all_trials(options: argparse.Namespace, bench: Bench, work: Path) -> list[Outcome]:
    bench.prepare()
    todo = []
    for part in options.part or PARTS:
        count = options.trials or importlib.import_module(f"tests.chaos.{part}").TRIALS
        todo += [(part, seed) for seed in range(options.seed, options.seed + count)]
    outcomes: dict[int, Outcome] = {}
    at_work: dict[int, tuple[int, int, float]] = {}
    waiting = list(enumerate(todo))
    while waiting or at_work:
        while waiting and len(at_work) < options.jobs:
            number, (part, seed) = waiting.pop(0)
            reader, pid = _begin(part, seed, bench, work / f"{part}-{seed}", options.keep)
            at_work[pid] = (number, reader, time.monotonic())
        for pid, (number, reader, since) in list(at_work.items()):
            part, seed = todo[number]
            late = time.monotonic() - since > LONGEST_S
            if late:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            if os.waitpid(pid, 0 if late else os.WNOHANG)[0] == 0:
                continue
            with open(reader, encoding="utf-8") as told:
                text = told.read()
            kind = importlib.import_module(f"tests.chaos.{part}").kind(seed)
            if text:
                outcome = Outcome(part, kind, seed, **json.loads(text))
            else:
                outcome = Outcome(
                    part, kind, seed, "hang" if late else "unclear", "the trial itself did not end well"
                )
            outcomes[number] = outcome
            if outcome.verdict not in ("held", "skipped"):
                print(outcome, flush=True)
            del at_work[pid]
        time.sleep(0.005)
    return [outcomes[number] for number in sorted(outcomes)]


def _begin(part: str, seed: int, bench: Bench, room: Path, keep: bool) -> tuple[int, int]:
    """One trial in a process of its own, which tells how it went through a pipe."""
    module = importlib.import_module(f"tests.chaos.{part}")
    reader, writer = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        os.close(writer)
        return reader, pid
    began = time.monotonic()
    told = {"verdict": "held", "text": ""}
    try:
        module.trial(Trial(bench, room, seed))
    except (TrialError, SkippedError) as error:
        told = {"verdict": getattr(error, "verdict", "skipped"), "text": str(error)}
    except BaseException:  # noqa: BLE001  (this is where the process ends, whatever came)
        told = {"verdict": "unclear", "text": f"the trial itself failed: {traceback.format_exc()[-1500:]}"}
    with contextlib.suppress(BaseException):
        if not keep or told["verdict"] == "held":
            subprocess.run(["rm", "-rf", "--one-file-system", str(room)], check=False)
    os.write(writer, json.dumps({**told, "seconds": time.monotonic() - began}).encode())
    os._exit(0)


def _write_table(file: Path, made: str) -> None:
    text = file.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    file.write_text(f"{head}{BEGIN}\n{made}\n{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
