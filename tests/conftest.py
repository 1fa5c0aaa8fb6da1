"""What several test files share."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# The collector of cycles looks through thousands of tests again and again, most of all while
# compiling, which makes many small objects. After 50,000 of them instead of 700 it costs little.
gc.set_threshold(50_000, 10, 10)


def pytest_collection_finish() -> None:
    """Spare the collector the tests, which stay to the end."""
    gc.freeze()


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real measurements, which are not part of the project; skips where it is absent.

    `GONIO_TEST_DATA` names it, else `shared/data` beside the repository.
    """
    named = os.environ.get("GONIO_TEST_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real measurements at {folder}; set GONIO_TEST_DATA to their folder")
    return folder


@pytest.fixture
def gonio(capsys):
    """Run the command line in this process: (exit code, stdout, stderr)."""

    def run(*words):
        from gonio import cli

        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in words])
        return left.value.code, *capsys.readouterr()

    return run
