"""The form of a verdict: what somebody who acts on a measurement should know. Pure Python."""

from typing import Literal

Severity = Literal["good", "doubtful", "bad"]
"""good: as it should be, or a plain number; doubtful: usable, look at it; bad: do not use it as it is."""
Verdict = list[tuple[Severity, str]]
"""Pairs of a severity and a sentence."""
