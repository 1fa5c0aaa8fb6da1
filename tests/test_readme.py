"""README.md shows what is printed; tests/readme_commands.py runs all of it, the demo included."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from readme_commands import ROOT, steps, unlike

README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("shown", "printed", "line"),
    [
        (["a", "b"], "a\nb\n", None),
        (["a  ", "", "b"], "a\n\nb   \n", None),
        (["...", "b"], "a\na\nb\n", None),
        (["a", "..."], "a\nb\nc\n", None),
        (["a", "c"], "a\nb\nc\n", "c"),
        (["...", "0.20"], "0.21\n", "0.20"),
        (["a"], "a\nb\n", "the end, before 'b'"),
        ([], "anything\n", None),
    ],
)
def test_output_that_is_not_printed_is_found(shown, printed, line):
    assert unlike(shown, printed) == line


def test_readme_shows_all_that_the_demo_prints():
    _, shown = next(step for step in steps(README) if step[0] == "make demo")
    text = "\n".join(shown)
    for word in ("rho_d ", "alpha_y ", "chi2/dof", "posterior:", "residuals:", "self-calibrated:",
                 "demo/rolled_aluminum.png"):  # fmt: skip
        assert word in text
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ndemo: $(INST")[2]
    files = re.findall(r"-o (demo/\S+)", recipe.partition("\n\n")[0])
    assert len(files) == 4
    assert all(file in text for file in files)


def test_the_example_of_own_data_prints_what_is_shown(tmp_path):
    every = list(steps(README))
    first = next(k for k, (command, _) in enumerate(every) if "measured.csv <<" in command)
    assert every[first][0].splitlines()[1] == "theta_i,phi_i,theta_r,phi_r,brdf,u_brdf"
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for command, shown in every[first : first + 3]:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command], cwd=tmp_path, check=True, text=True,
            env={**os.environ, "PATH": path}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        assert unlike(shown, done.stdout) is None
