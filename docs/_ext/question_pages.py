"""The table of questions to BRDF samples, made from its files when the site is built.

One row is one file of `gonio/checks/questions`. Nobody writes a row; a new file has one.
"""

from __future__ import annotations

from pathlib import Path

from model_pages import escape, table

from gonio.checks.questions import all_questions


def write(folder: Path) -> None:
    """Write the table to be included into a page, to a folder that is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "questions.txt").write_text(questions_table(), encoding="utf-8")


def questions_table() -> str:
    """A row for each question to BRDF samples."""
    heading = ["question", "what is compared", "findings"]
    rows = [
        [
            escape(question.asks),
            escape(question.compares),
            ", ".join(f"`{code}`" for code in question.codes),
        ]
        for question in all_questions()
    ]
    return table(heading, rows) + "\n"
