"""Records are found by looking into the folder of a package."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gonio.discovery import modules_in, records_in

FILES = {
    "__init__.py": "raise_nothing = True",
    "second.py": "RECORD = 2",
    "first.py": "RECORD = 1",
    "_third.py": "RECORD = 3",
    "other_type.py": "RECORD = 'text'",
    "without.py": "NUMBER = 4",
    "notes.txt": "RECORD = 5",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of a package `drawer`, which can be imported."""
    folder = tmp_path / "drawer"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text + "\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "drawer"]:
        del sys.modules[name]


def test_modules_come_in_the_order_of_their_names(package: Path) -> None:
    names = [module.__name__.partition(".")[2] for module in modules_in("drawer")]
    assert names == ["_third", "first", "other_type", "second", "without"]


def test_private_modules_are_left_out_and_not_imported_on_request(package: Path) -> None:
    names = [module.__name__.partition(".")[2] for module in modules_in("drawer", private=False)]
    assert names == ["first", "other_type", "second", "without"]
    assert "drawer._third" not in sys.modules


def test_records_are_those_of_the_type_in_the_order_of_the_modules(package: Path) -> None:
    assert records_in("drawer", "RECORD", int) == [3, 1, 2]
    assert records_in("drawer", "RECORD", str) == ["text"]
    assert records_in("drawer", "MISSING", int) == []


def test_a_module_that_cannot_be_imported_says_so(package: Path) -> None:
    (package / "broken.py").write_text("raise ValueError('no dome')\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^no dome$"):
        records_in("drawer", "RECORD", int)


def test_a_folder_that_joins_the_path_of_the_package_is_looked_into(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import drawer  # type: ignore[import-not-found]

    more = tmp_path / "more"
    more.mkdir()
    (more / "zebra.py").write_text("RECORD = 9\n", encoding="utf-8")
    monkeypatch.setattr(drawer, "__path__", [*drawer.__path__, str(more)])
    assert records_in("drawer", "RECORD", int) == [3, 1, 2, 9]
