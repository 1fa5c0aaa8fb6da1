"""A fit's result as pandas tables; angles in radians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gonio.fitting.result.record import FitRecord

if TYPE_CHECKING:
    import pandas as pd

_COLUMNS = (
    "value", "stderr", "unit", "at_bound", "low_68", "high_68", "low_95", "high_95",
)  # fmt: skip


def parameters_frame(record: FitRecord) -> pd.DataFrame:
    """One row a parameter; NaN stands for what is not known."""
    import pandas as pd

    rows = {
        name: (
            e.value, e.stderr, e.unit, e.at_bound,
            *(e.interval_68 or (None, None)), *(e.interval_95 or (None, None)),
        )
        for name, e in record.parameters.items()
    }  # fmt: skip
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=list(_COLUMNS))
    numbers = [name for name in _COLUMNS if name not in ("unit", "at_bound")]
    frame[numbers] = frame[numbers].astype(float)
    frame.index.name = "parameter"
    return frame


def matrix_frame(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> pd.DataFrame:
    """A square table with the parameters' names on both sides; NaN where a number is not known."""
    import pandas as pd

    return pd.DataFrame(rows, index=list(names), columns=list(names), dtype=float)
