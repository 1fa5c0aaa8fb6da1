"""What a shell completes: names of models, materials and instruments, without heavy imports."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from gonio import materials, models
from gonio.instrument import preset_names


def completed(*words: str) -> list[tuple[str, str]]:
    """Kind and text of what bash is offered for the last of these words behind `gonio`."""
    code = (
        "import sys; from gonio.cli import main\n"
        "try:\n    main([])\nfinally:\n"
        "    heavy = ('numba', 'scipy', 'matplotlib', 'cv2', 'xarray', 'zarr', 'emcee', 'nlopt')\n"
        "    import json; print(json.dumps([n for n in heavy if n in sys.modules]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={
            **os.environ,
            "_GONIO_COMPLETE": "bash_complete",
            "COMP_WORDS": " ".join(["gonio", *words]),
            "COMP_CWORD": str(len(words)),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    *lines, heavy = done.stdout.splitlines()
    assert json.loads(heavy) == []
    return [(kind, text) for kind, _, text in (line.partition(",") for line in lines)]


def plain(*names: str) -> list[tuple[str, str]]:
    return [("plain", name) for name in names]


def test_commands() -> None:
    assert completed("si") == plain("simulate")


def test_models() -> None:
    ward = [name for name in models.names() if name.startswith("ward")]
    assert len(ward) > 3
    assert completed("fit", "x.nc", "--model", "ward") == plain(*ward)


def test_a_term_of_a_sum_and_a_list_of_models() -> None:
    assert completed("fit", "x.nc", "--model", "lambert+ward_d") == plain("lambert+ward_duer")
    assert completed("compare", "x.nc", "--models", "phong,blinn+ward_g") == plain(
        "phong,blinn+ward_gmd"
    )


def test_materials() -> None:
    rolled = [name for name in materials.names() if name.startswith("rolled")]
    assert completed("simulate", "rolled") == plain(*rolled)
    assert completed("render", "sphere", "--material", "rolled") == plain(*rolled)


def test_instruments() -> None:
    assert completed("instruments", "") == plain(*preset_names())
    assert completed("simulate", "white_sand", "--instrument", "lbl") == plain("lbl1992")


@pytest.mark.parametrize("words", [("instruments", "rigs/my"), ("check", "data/my")])
def test_a_file_where_no_name_fits(words: tuple[str, str]) -> None:
    assert completed(*words) == [("file", words[1])]
