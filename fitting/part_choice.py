"""One part of a joint fit by its wavelength, channel or name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from gonio.errors import ConfigurationError
from gonio.fitting.result import FitResult, PartFit
from gonio.wording import counted


def choose_part(
    result: FitResult, select: Mapping[str, str], *, where: str = "the fit"
) -> PartFit | None:
    """The part of a joint fit that a selection leaves, or None where it leaves several.

    Parameters
    ----------
    result : FitResult
    select : mapping of str to str
        ``{"wavelength": "650"}``, ``{"channel": "red"}`` or ``{"part": "650 nm"}``.
    where : str
        What the messages call the fit.

    Raises
    ------
    ConfigurationError
        If no part is left, or the fit is not a joint one and something was selected.
    """
    if not result.parts:
        if select:
            raise ConfigurationError(
                f"{where}: a fit of one BRDF has no parts to select; leave the selection out.",
                value=dict(select),
            )
        return None
    for key in select:
        if key not in ("channel", "wavelength", "part"):
            raise ConfigurationError(
                f"selection {key}: of a joint fit wavelength, channel or part can be selected.",
                value=key,
            )
    left = [part for part in result.parts if all(_is(part, k, v) for k, v in select.items())]
    if not left:
        wanted = ", ".join(f"{key}={value}" for key, value in select.items())
        raise ConfigurationError(
            f"{where}: no part of the fit is {wanted}; its parts are "
            f"{', '.join(part.name for part in result.parts)}.",
            value=dict(select),
        )
    return left[0] if len(left) == 1 else None


def _is(part: PartFit, key: str, wanted: str) -> bool:
    if key == "part":
        return part.name == wanted
    own = part.select.get(key)
    if own is None or key == "channel":
        return own == wanted
    try:
        return math.isclose(float(own), float(wanted), abs_tol=1e-6)
    except ValueError:
        return False


def part_chooser(
    select: Mapping[str, str],
    *,
    where: str = "the fit",
    middle: Callable[[FitResult, PartFit], None] | None = None,
    shown: Callable[[PartFit], str] | None = None,
) -> Callable[[FitResult], FitResult]:
    """What takes the selected part out of a joint fit, and leaves another fit alone.

    Parameters
    ----------
    select : mapping of str to str
        As for `choose_part`.
    where : str
        What the messages call the fit.
    middle : callable, optional
        Take the middle part where nothing is selected, and call this with fit and part.
    shown : callable, optional
        How a selection of a part is written, for the messages.

    Raises
    ------
    ConfigurationError
        By the function, if the selection leaves no part or several.
    """
    write = shown or (lambda part: f"select={how_to_select(part)}")

    def choose(fit: FitResult) -> FitResult:
        part = choose_part(fit, select, where=where)
        if not fit.parts:
            return fit
        if part is None and middle is not None and not select:
            part = fit.parts[len(fit.parts) // 2]
            middle(fit, part)
        if part is None:
            raise ConfigurationError(
                f"{where}: a joint fit of {counted(len(fit.parts), 'part')}; choose one, as with "
                f"{write(fit.parts[0])}, of {', '.join(p.name for p in fit.parts)}.",
                value=where,
            )
        return fit.part(part.name)

    return choose


def how_to_select(part: PartFit) -> dict[str, str]:
    """The selection that leaves this part alone."""
    return dict(part.select) if part.input is None else {"part": part.name}
