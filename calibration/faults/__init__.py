"""What is wrong with a session. One file of this folder is one question.

A file that defines `QUESTION = Question(...)` is a question. No other file lists it.
"""

from __future__ import annotations

from functools import cache

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence
from gonio.discovery import records_in

__all__ = ["all_questions", "findings"]


@cache
def all_questions() -> tuple[Question, ...]:
    """Every question, in its order.

    Examples
    --------
    >>> "dark_level" in [question.key for question in all_questions()]
    True
    """
    questions = records_in(__name__, "QUESTION", Question)
    return tuple(sorted(questions, key=lambda question: (question.order, question.key)))


def findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Everything that is wrong with a channel, errors first."""
    answers = [finding for question in all_questions() for finding in question.ask(evidence)]
    return tuple(sorted(answers, key=lambda finding: finding.severity != "error"))
