"""The papers' materials against the numbers in print, typed here a second time."""

from __future__ import annotations

import importlib.util
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from gonio import materials, models
from gonio.errors import ConfigurationError
from gonio.geometry import Directions

# Ward 1992, section 6: rho_d, rho_s, alpha_x, alpha_y.
WARD = {
    "rolled_brass": (0.10, 0.33, 0.050, 0.16),
    "rolled_aluminum": (0.10, 0.21, 0.04, 0.09),
    "lightly_brushed_aluminum": (0.15, 0.19, 0.088, 0.13),
    "varnished_plywood": (0.33, 0.025, 0.04, 0.11),
    "enamel_finished_metal": (0.25, 0.047, 0.080, 0.096),
    "painted_cardboard_box": (0.19, 0.043, 0.076, 0.085),
    "white_ceramic_tile": (0.70, 0.050, 0.071, 0.071),
    "glossy_grey_paper": (0.29, 0.083, 0.082, 0.082),
    "ivory_computer_plastic": (0.45, 0.043, 0.13, 0.13),
    "plastic_laminate": (0.67, 0.070, 0.092, 0.092),
}

# The two latex tables, row by row: alpha_x, alpha_y for brushed, rolled, sprayed.
LATEX = {
    ("semigloss", "metal"): ((0.037, 0.064), (0.045, 0.068), (0.041, 0.055)),
    ("semigloss", "sheetrock"): ((0.078, 0.12), (0.083, 0.12), (0.096, 0.11)),
    ("semigloss", "wood"): ((0.097, 0.24), (0.12, 0.26), (0.099, 0.26)),
    ("gloss", "metal"): ((0.037, 0.063), (0.054, 0.080), (0.038, 0.054)),
    ("gloss", "sheetrock"): ((0.10, 0.10), (0.12, 0.12), (0.10, 0.10)),
    ("gloss", "wood"): ((0.13, 0.22), (0.13, 0.20), (0.12, 0.17)),
}
LATEX_RHO_S = {"semigloss": 0.048, "gloss": 0.059}

# Oren & Nayar 1994, captions of Figures 8 to 11 and section 5; sigma in degrees.
OREN_NAYAR = {
    "wall_plaster": ("oren_nayar", {"sigma": 30, "rho": 0.90}),
    "white_sand": ("oren_nayar", {"sigma": 35, "rho": 0.80}),
    "foam": ("oren_nayar_torrance_sparrow", {"sigma": 20, "rho": 0.8, "ks_over_kb": 0.019}),
    "cotton_towel": (
        "oren_nayar_torrance_sparrow",
        {"sigma": 42, "rho": 0.75, "ks_over_kb": 0.085},
    ),
    "clay_vase": ("oren_nayar", {"rho": 0.7, "sigma": 40}),
}


def printed() -> dict[str, tuple[str, dict[str, float]]]:
    """Model and parameters of all materials, angles in degrees."""
    wards = dict(WARD)
    for (paint, base), row in LATEX.items():
        for method, (alpha_x, alpha_y) in zip(("brushed", "rolled", "sprayed"), row, strict=True):
            name = f"latex_{paint}_{method}_{base}"
            wards[name] = (0.45, LATEX_RHO_S[paint], alpha_x, alpha_y)
    keys = ("rho_d", "rho_s", "alpha_x", "alpha_y")
    table = {name: ("ward", dict(zip(keys, row, strict=True))) for name, row in wards.items()}
    return {**table, **{k: (m, dict(p)) for k, (m, p) in OREN_NAYAR.items()}}


PRINTED = printed()


def test_all_materials_are_there():
    assert len(PRINTED) == 33
    assert set(materials.names()) == set(PRINTED)


@pytest.mark.parametrize("name", PRINTED)
def test_numbers_are_those_in_print(name):
    model, parameters = PRINTED[name]
    material = materials.get(name)
    assert material.name == name
    assert material.model == model
    assert material.describe()["parameters"] == parameters
    in_radians = {k: np.radians(v) if k == "sigma" else v for k, v in parameters.items()}
    assert dict(material.parameters) == in_radians


@pytest.mark.parametrize("name", PRINTED)
def test_the_model_takes_the_parameters(name):
    material = materials.get(name)
    model = models.get(material.model)
    assert set(material.parameters) == set(model.names)
    f = model(Directions(0.5, 0.0, 0.5, np.pi), **material.parameters)
    assert 0 < float(f) < 100


@pytest.mark.parametrize("name", PRINTED)
def test_the_source_is_reported(name):
    material = materials.get(name)
    assert material.title
    assert material.note
    assert ("pp. 265-272" if material.model == "ward" else "pp. 239-246") in material.paper
    assert "section" in material.where


def test_isotropic_materials():
    isotropic = {name for name in PRINTED if not materials.get(name).anisotropic}
    assert isotropic == {
        "white_ceramic_tile",
        "glossy_grey_paper",
        "ivory_computer_plastic",
        "plastic_laminate",
        "latex_gloss_brushed_sheetrock",
        "latex_gloss_rolled_sheetrock",
        "latex_gloss_sprayed_sheetrock",
        *OREN_NAYAR,
    }


def test_unknown_name_suggests_the_nearest():
    message = "unknown material 'roled_brass': did you mean 'rolled_brass'"
    with pytest.raises(ConfigurationError, match=message):
        materials.get("roled_brass")


def test_the_data_folder_refuses_another_name():
    path = Path(str(files("gonio.data"))) / "__init__.py"
    spec = importlib.util.spec_from_file_location("data", path)
    assert spec is not None
    assert spec.loader is not None
    with pytest.raises(ImportError, match=r"package gonio\.data and was imported as 'data'"):
        spec.loader.exec_module(importlib.util.module_from_spec(spec))
