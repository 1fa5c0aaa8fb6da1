"""Priors: what is held of a parameter before the data, declared with it or given for one fit.

A prior is written flat, log (flat in the logarithm), normal(mean, sd), lognormal(median, factor) or
half_normal(sd), and always ends at the bounds of its parameter. Priors enter the posterior alone;
the least-squares minimum and its covariance do not know them. Texts of parameters and files hold
degrees for angles; texts that Python gives to `resolve` hold radians.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gonio.errors import ConfigurationError, unknown_name
from gonio.geometry import FloatArray
from gonio.models import Parameter

Kind = Literal["flat", "log", "normal", "lognormal", "half_normal"]
NUMBERS: dict[str, tuple[str, ...]] = {
    "flat": (),
    "log": (),
    "normal": ("mean", "sd"),
    "lognormal": ("median", "factor"),
    "half_normal": ("sd",),
}
FORMS = "flat, log, normal(mean, sd), lognormal(median, factor) or half_normal(sd)"
FAR = 5.0  # standard deviations that a mean may lie outside the bounds


@dataclass(frozen=True)
class Prior:
    """The prior of one parameter, up to a constant, between its bounds.

    Parameters
    ----------
    kind : {"flat", "log", "normal", "lognormal", "half_normal"}
    centre : float
        Mean of a normal, median of a lognormal, the lower bound for a half-normal; Python units.
    width : float
        Standard deviation; of ln p for a lognormal (the logarithm of its factor).
    """

    kind: Kind = "flat"
    centre: float = 0.0
    width: float = 1.0

    @property
    def gaussian(self) -> tuple[float, float] | None:
        """Mean and precision (1/sd^2) where the prior is Gaussian or flat, else None."""
        if self.kind == "flat":
            return self.centre, 0.0
        return (self.centre, self.width**-2) if self.kind in {"normal", "half_normal"} else None

    def log_density(self, p: FloatArray) -> FloatArray:
        """Log of the density up to a constant; p inside the bounds of the parameter."""
        if self.kind == "flat":
            return np.zeros_like(p)
        if self.kind in {"normal", "half_normal"}:
            return -((p - self.centre) ** 2) / (2 * self.width**2)
        with np.errstate(divide="ignore"):
            log_p = np.log(p)
        if self.kind == "log":
            return -log_p
        z = (log_p - math.log(self.centre)) / self.width
        return np.where(p > 0, -(z**2) / 2 - log_p, -np.inf)

    def text(self, q: Parameter) -> str:
        """The prior as it is written, in the unit of files.

        Examples
        --------
        >>> angle = Parameter("sigma", "sigma", "slope angle", 0.3, 0.0, 1.5, "rad")
        >>> parse(angle, "normal(20, 5)").text(angle)
        'normal(20, 5)'
        """
        if self.kind in {"flat", "log"}:
            return self.kind
        width = math.exp(self.width) if self.kind == "lognormal" else q.to_file(self.width)
        numbers = [width] if self.kind == "half_normal" else [q.to_file(self.centre), width]
        return f"{self.kind}({', '.join(f'{number:.10g}' for number in numbers)})"


def parse(q: Parameter, text: str) -> Prior:
    """The prior of a parameter from its text, in the unit of files (degrees for angles).

    Raises
    ------
    ConfigurationError
        If the text is none of the forms, or its numbers make no sense for the parameter.
    """
    match = re.fullmatch(r"\s*([a-z_]+)\s*(?:\(([^()]*)\))?\s*", text)
    kind = match.group(1) if match else ""
    if match is None or kind not in get_args(Kind):
        raise ConfigurationError(
            f"the prior {text!r} of {q.name} is not understood; allowed are {FORMS}.", value=text
        )
    names = NUMBERS[kind]
    items = [item for item in (match.group(2) or "").split(",") if item.strip() or names]
    items = items if match.group(2) is not None else []
    numbers = [_number(item) for item in items]
    if len(numbers) != len(names) or None in numbers:
        wanted = " and ".join(names) or "no number"
        raise ConfigurationError(
            f"the prior {text!r} of {q.name} must have {wanted}"
            + (f", as in {kind}({', '.join(names)})." if names else f": write {kind}."),
            value=text,
        )
    return _checked(q, text, kind, [n for n in numbers if n is not None])


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _checked(q: Parameter, text: str, kind: str, numbers: Sequence[float]) -> Prior:
    """The prior in Python units, or what is wrong with it."""
    flaw = ""
    prior = Prior()
    if kind == "log":
        prior = Prior("log")
        if q.lower <= 0:
            flaw = (
                f"needs a lower bound above 0, and that of {q.name} is {q.to_file(q.lower):.6g}: "
                "ln p would be unbounded"
            )
    elif kind == "normal":
        centre, width = (q.from_file(number) for number in numbers)
        flaw = "needs an sd above 0" if width <= 0 else ""
        if not flaw:
            prior = Prior("normal", centre, width)
            outside = max(q.lower - centre, centre - q.upper)
            if outside > FAR * width:
                flaw = (
                    f"has its mean {outside / width:.3g} sd outside the bounds "
                    f"{q.to_file(q.lower):.6g} to {q.to_file(q.upper):.6g}"
                )
    elif kind == "lognormal":
        centre, factor = q.from_file(numbers[0]), numbers[1]
        if factor <= 1:
            flaw = "needs a factor above 1 (1.2 means about 20 %)"
        elif centre <= 0 or not q.lower <= centre <= q.upper:
            flaw = (
                f"needs a median above 0 within the bounds {q.to_file(q.lower):.6g} to "
                f"{q.to_file(q.upper):.6g}"
            )
        else:
            prior = Prior("lognormal", centre, math.log(factor))
    elif kind == "half_normal":
        width = q.from_file(numbers[0])
        flaw = "needs an sd above 0" if width <= 0 else ""
        prior = prior if flaw else Prior("half_normal", q.lower, width)
    if flaw:
        raise ConfigurationError(f"the prior {text!r} of {q.name} {flaw}.", value=text)
    return prior


def resolve(
    parameters: tuple[Parameter, ...], given: Mapping[str, str | Prior] | None = None
) -> tuple[Prior, ...]:
    """The prior of every parameter: as given, angles in radians, else as declared with it.

    A prior for `rho_d` also holds for `rho_d[red]` of a joint fit, unless that has its own.

    Raises
    ------
    ConfigurationError
        For an unknown parameter, or as `parse`.

    Examples
    --------
    >>> from gonio import models
    >>> ward = models.get("ward")
    >>> resolve(ward.parameters, {"alpha_x": "normal(0.1, 0.02)"})[2]
    Prior(kind='normal', centre=0.1, width=0.02)
    """
    given = dict(given or {})
    names = tuple(q.name for q in parameters)
    stems = {q.name: q.name.partition("[")[0] for q in parameters}
    for name in given:
        if name not in names and name not in stems.values():
            raise unknown_name("parameter of a prior", name, names)
    chosen = []
    for q in parameters:
        prior = given.get(q.name, given.get(stems[q.name]))
        if prior is None:
            prior = parse(q, q.prior)
        elif isinstance(prior, str):
            prior = parse(replace(q, unit=""), prior)  # its numbers are those of Python
        chosen.append(prior)
    return tuple(chosen)
