"""Are the wavelengths in nanometres?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence

MICROMETRES = 5.0  # below this no wavelength in nm is measured with mirrors and lamps
POSSIBLY = 30.0  # up to this lies the extreme ultraviolet, or thermal infrared in micrometres
METRES = 1e-3


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Wavelengths that only another unit explains, and channels that are called by numbers."""
    wavelength, channel = evidence.samples.wavelength_nm, evidence.samples.channel
    if wavelength is not None and len(wavelength):
        low, high = float(wavelength.min()), float(wavelength.max())
        said = f"wavelength_nm is {low:.6g}" + (f" to {high:.6g}" if high > low else "")
        if high < METRES:
            yield Finding(
                "wavelength_unit",
                "warning",
                f"{said} nm: these are metres. Multiply wavelength_nm by 1e9.",
            )
        elif high < POSSIBLY:
            sure = high < MICROMETRES
            yield Finding(
                "wavelength_unit",
                "warning" if sure else "note",
                f"{said} nm: {'these are' if sure else 'are these'} micrometres"
                f"{'.' if sure else '?'} {'Multiply' if sure else 'Then multiply'} wavelength_nm "
                "by 1000.",
            )
    if channel is not None and wavelength is None:
        names = np.unique(channel).tolist()
        numbers = [_number(name) for name in names]
        if numbers and all(0.1 <= x < 2e4 for x in numbers) and any(
            not x.is_integer() or x >= 100 for x in numbers
        ):  # fmt: skip
            unit = "micrometres" if max(numbers) < POSSIBLY else "nm"
            factor = ", multiplied by 1000" if unit == "micrometres" else ""
            yield Finding(
                "channel_is_wavelength",
                "note",
                f"the channels are called {', '.join(names[:6])}, which may be wavelengths in "
                f"{unit}. To select and share them as such, give a column wavelength_nm{factor}.",
            )


def _number(name: str) -> float:
    try:
        return float(name)
    except ValueError:
        return -1.0


QUESTION = Question(
    key="wavelength_unit",
    order=130,
    asks="Are the wavelengths in nanometres?",
    compares="wavelength_nm with 5 nm and 30 nm, names of channels with numbers",
    codes=("wavelength_unit", "channel_is_wavelength"),
    ask=ask,
    of_file=True,
)
