"""A model at a prompt and in a notebook."""

from __future__ import annotations

import pytest

from gonio import models


@pytest.mark.parametrize("name", models.names())
def test_a_model_prints_as_a_page(name):
    model = models.get(name)
    page = str(model)
    assert page.startswith(f"{name}: {model.title} ({model.reference})")
    assert len(page) < 8000
    for q in model.parameters:
        assert q.meaning in page
    assert len(repr(model)) < 300
    assert "\n" not in repr(model)


def test_the_page_gives_ranges_in_radians_with_degrees_beside():
    page = str(models.get("oren_nayar"))
    assert "sigma [rad]" in page
    assert "1.047 (60 deg)" in page
    assert page.endswith("Angles are radians in Python, degrees in files and on the command line.")
    assert "radians in Python" not in str(models.get("lambert"))
    assert repr(models.get("lambert")).startswith("<Model lambert(rho): ")


def test_html_holds_the_table_and_the_formula():
    html = models.get("ward")._repr_html_()
    assert html.count("<tr>") == 1 + 4
    assert "<details><summary>formula</summary><pre>" in html


def test_a_sum_of_models_prints_too():
    model = models.get("lambert+ward_duer")
    assert str(model).startswith("lambert+ward_duer: ")
    assert repr(model).startswith("<Model lambert+ward_duer(")
