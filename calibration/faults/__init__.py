"""What is wrong with a session: one file is one question, found by looking into this folder.

A file that defines `QUESTION = Question(...)` is a question; nothing else has to be told of it.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from gonio.calibration.faults.base import Finding, Question
from gonio.calibration.faults.evidence import Evidence

__all__ = ["all_questions", "findings"]


@cache
def all_questions() -> tuple[Question, ...]:
    """Every question, in its order.

    Examples
    --------
    >>> "dark_level" in [question.key for question in all_questions()]
    True
    """
    found = []
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        question = getattr(module, "QUESTION", None)
        if isinstance(question, Question):
            found.append(question)
    return tuple(sorted(found, key=lambda question: (question.order, question.key)))


def findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Everything that is wrong with a channel, errors first."""
    found = [finding for question in all_questions() for finding in question.ask(evidence)]
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))
