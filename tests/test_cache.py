"""Where compiled code is kept between runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from gonio import cache


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """A home of its own, and no variable that names a cache."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("GONIO_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    return monkeypatch


def test_the_home_holds_the_cache(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert cache.wanted_folder() == tmp_path / "home" / ".cache" / "gonio"


def test_xdg_cache_home_comes_before_the_home(
    environment: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    environment.setenv("XDG_CACHE_HOME", str(tmp_path / "shared"))
    assert cache.wanted_folder() == tmp_path / "shared" / "gonio"


@pytest.mark.parametrize("value", ["", "relative/folder"])
def test_xdg_cache_home_counts_where_it_is_an_absolute_path(
    environment: pytest.MonkeyPatch, tmp_path: Path, value: str
) -> None:
    # "If an implementation encounters a relative path [...] it should consider the path invalid
    # and ignore it": XDG Base Directory Specification.
    environment.setenv("XDG_CACHE_HOME", value)
    assert cache.wanted_folder() == tmp_path / "home" / ".cache" / "gonio"


def test_the_variable_of_gonio_comes_first(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environment.setenv("XDG_CACHE_HOME", str(tmp_path / "shared"))
    environment.setenv("GONIO_CACHE_DIR", str(tmp_path / "own"))
    assert cache.wanted_folder() == tmp_path / "own"


def test_compiled_code_goes_there(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environment.setenv("XDG_CACHE_HOME", str(tmp_path / "shared"))
    cache.folder.cache_clear()
    try:
        assert cache.folder() == tmp_path / "shared" / "gonio"
        assert cache.folder().is_dir()
    finally:
        cache.folder.cache_clear()
