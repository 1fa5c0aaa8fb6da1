"""Did lines of the file hold no reading?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import SHOWN, Evidence


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Lines that the reader left out: cells that are no numbers, u_brdf that is not positive."""
    record = evidence.samples.metadata.get("reading", {}).get("left_out", {})
    kinds = (
        ("no_value", "no_reading", "hold no number as their reading", "Correct or remove them"),
        ("no_uncertainty", "no_uncertainty", "have no positive u_brdf",
         "State it, or leave the column out where it is unknown"),
    )  # fmt: skip
    for key, code, what, cure in kinds:
        lines = record.get(key, [])
        if not lines:
            continue
        count = record[f"n_{key}"]
        more = f" and {count - SHOWN} more" if count > SHOWN else ""
        named = ", ".join(str(line) for line in lines[:SHOWN])
        yield Finding(
            code,
            "warning",
            f"{count} of {record['of']} lines {what} and were left out (lines {named}{more}). "
            f"{cure}.",
            lines=tuple(lines),
            left_out=True,
        )


QUESTION = Question(
    key="no_reading",
    order=10,
    asks="Does every line hold a reading?",
    compares="the cells of brdf and u_brdf with numbers, u_brdf with 0",
    codes=("no_reading", "no_uncertainty"),
    ask=ask,
    of_file=True,
)
