"""The version of gonio, apart from the package's root so that every room may state it."""

from __future__ import annotations

__version__ = "0.2.0"
