"""Statements of the person who signs a report: operator, dates, equipment and coverage."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from gonio.errors import ConfigurationError

LARGEST_FACTOR = 10.0
LEAST_LEVEL = 50.0  # per cent


@dataclass(frozen=True)
class Statement:
    """Facts of a report that are not in the fit or its data.

    Parameters
    ----------
    operator : str or None
        Who measured.
    dates : tuple of str
        Of the measurement, YYYY-MM-DD.
    issued : str or None
        Date of the report, YYYY-MM-DD.
    serials : tuple of (str, str)
        Name of an item, such as sample, lamp or standard, and its serial number.
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
        """Name and value of each line in the head of a report; missing values are left out."""
        lines = [("Operator", self.operator or "")]
        lines += [("Measured on", ", ".join(self.dates))]
        lines += [("Issued on", self.issued or "")]
        lines += [(f"Serial number, {name}", number) for name, number in self.serials]
        return [(name, value) for name, value in lines if value]

    def coverage_sentence(self) -> str | None:
        """Meaning of U; None where neither a coverage nor degrees of freedom were given."""
        freedom = "" if self.dof is None else f"{self.dof:g} effective degrees of freedom"
        if self.coverage is None:
            return f"The uncertainties have {freedom}." if freedom else None
        meaning = (
            f"U = k u is the expanded uncertainty with the coverage factor k = {self.coverage:.4g}"
        )
        if self.level is not None:
            law = f"Student's distribution with {freedom}" if freedom else "a normal distribution"
            return f"{meaning}, for a coverage probability of {self.level:g} % under {law}."
        return f"{meaning}; the uncertainties have {freedom}." if freedom else f"{meaning}."


def statement(
    operator: str | None = None,
    dates: Iterable[str] = (),
    issued: str | None = None,
    serials: Mapping[str, str] | Iterable[str] = (),
    coverage: str | float | None = None,
    dof: float | None = None,
) -> Statement:
    """Make a statement from texts as a person writes them.

    Parameters
    ----------
    operator : str, optional
    dates : iterable of str
        Days of the measurement, YYYY-MM-DD.
    issued : str, optional
        Day of the report, YYYY-MM-DD.
    serials : mapping of str to str, or iterable of str
        Serial number of each item by its name, or texts NAME=NUMBER.
    coverage : str or float, optional
        A factor, 2, "2" or "k=2", or a probability, "95%", from which k follows by Student's
        distribution with `dof`, or by the normal one.
    dof : float, optional
        Effective degrees of freedom, at least 1.

    Raises
    ------
    ConfigurationError
        If a text cannot be read or a number is out of range.

    Examples
    --------
    >>> statement(coverage="95%", dof=9).coverage_sentence().partition(",")[0]
    'U = k u is the expanded uncertainty with the coverage factor k = 2.262'
    >>> statement(coverage=2, serials={"lamp": "AB-1234"}).facts()
    [('Serial number, lamp', 'AB-1234')]
    """
    if dof is not None and not dof >= 1:
        raise ConfigurationError(
            f"{dof:g} effective degrees of freedom: the number must be at least 1; leave it out "
            "where it is not known.",
            value=dof,
        )
    factor, level = (None, None) if coverage is None else _coverage(str(coverage), dof)
    if isinstance(serials, Mapping):
        serials = [f"{name}={number}" for name, number in serials.items()]
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
    match = re.fullmatch(r"\s*(k\s*=)?\s*(\d+\.?\d*|\.\d+)\s*(%)?\s*", text)
    number = float(match[2]) if match else 0.0
    if match and match[3] and not match[1] and LEAST_LEVEL <= number < 100:
        return _factor(number, dof), number
    if match and not match[3] and 0 < number <= LARGEST_FACTOR:
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
