"""What is implausible in BRDF samples. One file of this folder is one question.

A file that defines `QUESTION = Question(...)` is a question. No other file lists it.
"""

from __future__ import annotations

from functools import cache

from gonio.checks.questions.base import LEVELS, Finding, Level, Question
from gonio.checks.questions.evidence import Evidence
from gonio.discovery import records_in

__all__ = ["LEVELS", "Evidence", "Finding", "Level", "Question", "all_questions"]


@cache
def all_questions() -> tuple[Question, ...]:
    """Every question, in its order.

    Examples
    --------
    >>> "exact_zeros" in [question.key for question in all_questions()]
    True
    """
    questions = records_in(__name__, "QUESTION", Question)
    return tuple(sorted(questions, key=lambda question: (question.order, question.key)))
