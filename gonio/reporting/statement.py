"""What the person who signs a report states: who measured, when, with what, with which coverage."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gonio.errors import ConfigurationError

LARGEST_FACTOR = 10.0
LEAST_LEVEL = 50.0  # per cent


@dataclass(frozen=True)
class Statement:
    """What a report says besides what the fit and its data say of themselves.

    Parameters
    ----------
    operator : str or None
        Who measured.
    dates : tuple of str
        Of the measurement, YYYY-MM-DD.
    issued : str or None
        Date of the report, YYYY-MM-DD.
    serials : tuple of (str, str)
        What was used, such as sample, lamp or standard, and its serial number.
    coverage : float or None
        Coverage factor k of the expanded uncertainty U = k u.
    level : float or None
        Coverage probability in per cent, where k was chosen for it.
    dof : float or None
        Effective degrees of freedom of the combined uncertainties.
    """

    operator: str | None = None
    dates: tuple[str, ...] = ()
    issued: str | None = None
    serials: tuple[tuple[str, str], ...] = ()
    coverage: float | None = None
    level: float | None = None
    dof: float | None = None

    def facts(self) -> list[tuple[str, str]]:
        """Lines for the head of a report; what was not given is left out."""
        found = [("Operator", self.operator or "")]
        found += [("Measured on", ", ".join(self.dates))]
        found += [("Issued on", self.issued or "")]
        found += [(f"Serial number, {name}", number) for name, number in self.serials]
        return [(name, value) for name, value in found if value]

    def coverage_sentence(self) -> str | None:
        """What U means; None where no coverage was asked for."""
        freedom = "" if self.dof is None else f"{self.dof:g} effective degrees of freedom"
        if self.coverage is None:
            return f"The uncertainties have {freedom}." if freedom else None
        words = (
            f"U = k u is the expanded uncertainty with the coverage factor k = {self.coverage:.4g}"
        )
        if self.level is not None:
            law = f"Student's distribution with {freedom}" if freedom else "a normal distribution"
            return f"{words}, for a coverage probability of {self.level:g} % under {law}."
        return f"{words}; the uncertainties have {freedom}." if freedom else f"{words}."


def statement(
    operator: str | None = None,
    dates: Iterable[str] = (),
    issued: str | None = None,
    serials: Iterable[str] = (),
    coverage: str | None = None,
    dof: float | None = None,
) -> Statement:
    """A statement from texts as a person writes them.

    Parameters
    ----------
    operator : str, optional
    dates : iterable of str
        Days of the measurement, YYYY-MM-DD.
    issued : str, optional
        Day of the report, YYYY-MM-DD.
    serials : iterable of str
        NAME=NUMBER each.
    coverage : str, optional
        A factor, "2" or "k=2", or a probability, "95%", from which k follows by Student's
        distribution with `dof`, or by the normal one.
    dof : float, optional
        Effective degrees of freedom, at least 1.

    Raises
    ------
    ConfigurationError
        If a text cannot be read or a number is out of range.

    Examples
    --------
    >>> statement(coverage="95%", dof=9).coverage_sentence()  # doctest: +ELLIPSIS
    'U = k u is the expanded uncertainty with the coverage factor k = 2.262, for a coverage ...'
    """
    if dof is not None and not dof >= 1:
        raise ConfigurationError(
            f"{dof:g} effective degrees of freedom: the number must be at least 1; leave it out "
            "where it is not known.",
            value=dof,
        )
    factor, level = (None, None) if coverage is None else _coverage(coverage, dof)
    return Statement(
        (operator or "").strip() or None,
        tuple(_day(day) for day in dates),
        None if issued is None else _day(issued),
        tuple(_serial(text) for text in serials),
        factor,
        level,
        dof,
    )


def _day(text: str) -> str:
    try:
        return datetime.date.fromisoformat(text.strip()).isoformat()
    except ValueError:
        raise ConfigurationError(
            f"{text!r} is not a day; write it as YYYY-MM-DD, for instance 2026-03-31.", value=text
        ) from None


def _serial(text: str) -> tuple[str, str]:
    name, sign, number = (part.strip() for part in text.partition("="))
    if not (name and sign and number):
        raise ConfigurationError(
            f"{text!r} is not NAME=NUMBER; write for instance lamp=AB-1234.", value=text
        )
    return name, number


def _coverage(text: str, dof: float | None) -> tuple[float, float | None]:
    """Coverage factor, and the probability in per cent that it was chosen for."""
    found = re.fullmatch(r"\s*(k\s*=)?\s*(\d+\.?\d*|\.\d+)\s*(%)?\s*", text)
    number = float(found[2]) if found else 0.0
    if found and found[3] and not found[1] and LEAST_LEVEL <= number < 100:
        return _factor(number, dof), number
    if found and not found[3] and 0 < number <= LARGEST_FACTOR:
        return number, None
    raise ConfigurationError(
        f"the coverage {text!r} is neither a factor such as k=2 (above 0, up to "
        f"{LARGEST_FACTOR:g}) nor a probability such as 95% ({LEAST_LEVEL:g}% to below 100%).",
        value=text,
    )


def _factor(level: float, dof: float | None) -> float:
    """Two-sided quantile of the normal distribution, or of Student's where `dof` is given."""
    from scipy.stats import norm, t

    tail = (1 + level / 100) / 2
    return float(norm.ppf(tail) if dof is None or np.isinf(dof) else t.ppf(tail, dof))
