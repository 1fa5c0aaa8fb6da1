"""Tables of the calibration, made from its files when the site is built.

One row is one file of `gonio/calibration/effects` or `gonio/calibration/faults`. Nobody writes a
row; a new file has one.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from model_pages import escape, table, text

from gonio.calibration.effects import all_effects
from gonio.calibration.effects.base import Effect, TermRecord
from gonio.calibration.faults import all_questions


def write(folder: Path) -> None:
    """Write the tables to be included into pages, to a folder that exists."""
    (folder / "effects.txt").write_text(effects_table(), encoding="utf-8")
    (folder / "terms.txt").write_text(terms_table(), encoding="utf-8")
    (folder / "questions.txt").write_text(questions_table(), encoding="utf-8")


def effects_table() -> str:
    """A row for each source of error: what it is, where it is stated, what may be unknown."""
    heading = ["source", "what it is, and what is done about it", "stated by", "unknown without"]
    rows = [
        [
            escape(effect.title),
            text(effect.text),
            _codes(stated.key for stated in effect.quantities) or "—",
            _codes(each.key for each in effect.unknown if each.key) or "—",
        ]
        for effect in all_effects()
    ]
    return table(heading, rows) + "\n"


def terms_table() -> str:
    """A row for each shared error, as a budget names it."""
    heading = ["in the budget", "source", "type", "more takes help", "its draw belongs to", "what"]
    rows = [_term(effect, term) for effect in all_effects() for term in effect.records]
    return table(heading, rows) + "\n"


def _term(effect: Effect, term: TermRecord) -> list[str]:
    return [
        escape(term.name),
        escape(effect.title),
        term.evaluation,
        "yes" if term.averages else "no",
        f"the {term.belongs_to}",
        escape(term.meaning) + ("; a typical pattern of many" if term.typical else ""),
    ]


def questions_table() -> str:
    """A row for each question to a session."""
    heading = ["question", "what is compared", "findings"]
    rows = [
        [escape(question.asks), escape(question.compares), _codes(question.codes)]
        for question in all_questions()
    ]
    return table(heading, rows) + "\n"


def _codes(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)
