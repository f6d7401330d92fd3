"""What a trial can end as, and the table of how many did."""

from collections.abc import Iterable
from dataclasses import dataclass


class TrialError(Exception):
    """A trial did not hold; the sentence says what was seen."""

    verdict = "wrong"


class WrongError(TrialError):
    """Something was delivered, said or left that is not true, and the exit code was 0."""


class HangError(TrialError):
    """A command did not come to an end in its time."""

    verdict = "hang"


class UnclearError(TrialError):
    """A command ended badly without one sentence that says why: a traceback, a signal, "unexpected"."""

    verdict = "unclear"


class SkippedError(Exception):
    """This machine cannot make the trial; the sentence says why."""


@dataclass(frozen=True)
class Outcome:
    """How one trial went."""

    part: str
    kind: str
    seed: int
    verdict: str
    """held, wrong, hang, unclear or skipped."""
    text: str = ""
    seconds: float = 0.0

    def __str__(self) -> str:
        return f"{self.verdict:8}{self.part} {self.seed} ({self.kind}): {self.text}"


COLUMNS = ("wrong", "hang", "unclear")


def table(outcomes: Iterable[Outcome]) -> str:
    """Markdown: part, kind, tried, wrong, hang, unclear; what was skipped is named below."""
    rows: dict[tuple[str, str], list[Outcome]] = {}
    skipped: dict[str, None] = {}
    for outcome in outcomes:
        if outcome.verdict == "skipped":
            skipped[f"{outcome.part}, {outcome.kind}: {outcome.text}"] = None
        else:
            rows.setdefault((outcome.part, outcome.kind), []).append(outcome)
    lines = ["| part | kind | tried | wrong | hang | unclear |", "|---|---|---:|---:|---:|---:|"]
    total = [0] * (1 + len(COLUMNS))
    for (part, kind), made in rows.items():
        counts = [len(made), *(sum(o.verdict == column for o in made) for column in COLUMNS)]
        total = [a + b for a, b in zip(total, counts, strict=True)]
        lines.append(f"| {part} | {kind} | {' | '.join(map(str, counts))} |")
    lines.append(f"| **all** | | {' | '.join(f'**{count}**' for count in total)} |")
    if skipped:
        lines += ["", *(f"Not tried on this machine: {text}." for text in skipped)]
    return "\n".join(lines)
