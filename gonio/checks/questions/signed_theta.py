"""Do polar angles carry a sign?"""

from __future__ import annotations

from collections.abc import Iterator

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import SHOWN, Evidence


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Negative polar angles that the reader turned into azimuths."""
    for name, record in evidence.samples.metadata.get("reading", {}).get("signed", {}).items():
        azimuth = name.replace("theta", "phi")
        lines, count = record["lines"], record["count"]
        more = f" and {count - SHOWN} more" if count > SHOWN else ""
        named = ", ".join(str(line) for line in lines[:SHOWN])
        yield Finding(
            "signed_theta",
            "note",
            f"{name} is negative on {count} lines ({named}{more}); such a direction was read as "
            f"positive with {azimuth} + 180 deg. If the sign means something else, rewrite the "
            "angles.",
            lines=tuple(lines),
        )


QUESTION = Question(
    key="signed_theta",
    order=20,
    asks="Do polar angles carry a sign?",
    compares="theta_i and theta_r of the file with 0",
    codes=("signed_theta",),
    ask=ask,
    of_file=True,
)
