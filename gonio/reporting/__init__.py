"""A fit as one HTML page that opens offline: what was measured, what was found, how well."""

from __future__ import annotations

from gonio.reporting.document import page
from gonio.reporting.inputs import Inputs, gather
from gonio.reporting.statement import Statement, statement

__all__ = ["Inputs", "Statement", "gather", "page", "statement"]
