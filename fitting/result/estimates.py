"""The entries of a fit's result: parameters, shared errors, posterior, parts. Unknown is None."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

Pair = tuple[float, float]


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter; angles in radians.

    Parameters
    ----------
    value : float
    stderr : float or None
        Standard uncertainty, shared terms included; None at a bound or where the data do not
        determine the parameter.
    unit : str
        "rad" for angles, "" for numbers; "deg" after `in_file_units`.
    at_bound : {"lower", "upper"} or None
    interval_68, interval_95 : tuple of float or None
        Posterior quantiles where there is a posterior; else from the standard uncertainty, or
        towards and at a bound from the growth of chi-squared by 1 and by 3.84.
    components : mapping of str to float
        Standard uncertainty by source: "independent" and the shared terms by name.
    fixed : bool
        The parameter was no unknown: its value was given, and it has no uncertainty.
    tied_to : str or None
        Name of the parameter whose value it takes, as `tied` asks.
    dof : float or None
        Degrees of freedom of the standard uncertainty: the intervals take Student's t with them.
        None where the noise is stated, so that they take the normal distribution, and without a
        standard uncertainty.
    established : bool or None
        None where nobody asked: without a standard uncertainty, or in a file of 0.1. False where
        a few samples carry the parameter, or where errors of the angles that nobody stated would
        move it by more than its standard uncertainty: the interval then says less than it seems
        to.
    """

    value: float
    stderr: float | None
    unit: str
    at_bound: Literal["lower", "upper"] | None
    interval_68: Pair | None
    interval_95: Pair | None
    components: Mapping[str, float] = field(default_factory=dict)
    fixed: bool = False
    tied_to: str | None = None
    dof: float | None = None
    established: bool | None = None

    @property
    def unknown(self) -> bool:
        """Whether the data determine the value: it is neither fixed nor tied."""
        return not self.fixed and self.tied_to is None

    def in_file_units(self) -> Estimate:
        """The estimate as files and tables show it: angles in degrees.

        Examples
        --------
        >>> Estimate(0.5, None, "rad", None, None, None).in_file_units().value
        28.64788975654116
        """
        return self._converted("rad", "deg", math.degrees)

    def in_python_units(self) -> Estimate:
        """The estimate as Python takes it: angles in radians."""
        return self._converted("deg", "rad", radians)

    def _converted(self, old: str, new: str, by: Callable[[float], float]) -> Estimate:
        if self.unit != old:
            return self
        return replace(
            self,
            value=by(self.value),
            stderr=None if self.stderr is None else by(self.stderr),
            unit=new,
            interval_68=_both(self.interval_68, by),
            interval_95=_both(self.interval_95, by),
            components={name: by(u) for name, u in self.components.items()},
        )


def radians(degrees: float) -> float:
    """Radians of an angle whose degrees are exactly this number, where there are any.

    `math.radians` may miss by a rounding, and a file that is read and written would change.
    """
    near = math.radians(degrees)
    for number in (near, math.nextafter(near, math.inf), math.nextafter(near, -math.inf)):
        if math.degrees(number) == degrees:
            return number
    return near


def _both(pair: Pair | None, by: Callable[[float], float]) -> Pair | None:
    return None if pair is None else (by(pair[0]), by(pair[1]))


@dataclass(frozen=True)
class NuisanceEstimate:
    """A shared error that the fit profiled, in units of its prior's standard uncertainty.

    Parameters
    ----------
    name : str
        Of the shared term.
    group : int or None
        Which of its draws, by the number that its samples have in common; None where all have.
    estimate : float
        0 where the data do not speak against the statement of the budget.
    stderr : float
        1 where the data say nothing about it, 0 where they know it.
    """

    name: str
    group: int | None
    estimate: float
    stderr: float


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled.

    Parameters
    ----------
    ess : float
        Smallest effective number of draws over the parameters.
    r_hat : float
        Largest rank-normalised split R-hat.
    tau : float
        Longest integrated autocorrelation time, steps.
    acceptance : float
        Share of accepted proposals.
    converged : bool
        Chain longer than 50 tau, R-hat below 1.01, and at least 400 effective draws for the bulk
        and for the tails.
    draws : str or None
        Path of the netCDF file with the draws.
    ess_bulk, ess_tail : float or None
        Smallest effective numbers of draws for the middle, which is `ess`, and for the 5 % and
        95 % quantiles.
    sampler : str or None
        "marginal" or "emcee".
    k_hat : float or None
        Shape of the tail of the marginal sampler's importance weights, also where its guard
        refused it; None where there was nothing to weigh.
    note : str
        Why the marginal sampler was not used where it was asked for; else empty.
    priors : mapping of str to str
        As `gonio.fitting.posterior.priors` writes them, angles in degrees.
    allowance : str
        What the spread of the draws allows for beyond the likelihood; empty for nothing.
    """

    ess: float
    r_hat: float
    tau: float
    acceptance: float
    converged: bool
    draws: str | None = None
    ess_bulk: float | None = None
    ess_tail: float | None = None
    sampler: str | None = None
    k_hat: float | None = None
    note: str = ""
    priors: Mapping[str, str] = field(default_factory=dict)
    allowance: str = ""


@dataclass(frozen=True)
class PartFit:
    """One channel, wavelength or material of a joint fit.

    Parameters
    ----------
    name : str
        "red", "650 nm", "paint_a", or "paint_a, red".
    parameters : mapping of str to str
        The name of each of the model's parameters in the parameters of the fit.
    alone : mapping of str to tuple
        Value and standard uncertainty (None where unknown) of each shared parameter in a fit to
        this part alone, radians for angles.
    chi2, dof, noise_scale : float, int, float
        Of this part: its residuals, its samples less the parameters that are its own, and the
        factor on its independent uncertainties.
    n_samples, n_negative : int
    select : mapping of str to str
        Takes the part out of its input.
    input : str or None
        The input that the part is of, where there are several.
    """

    name: str
    parameters: Mapping[str, str]
    alone: Mapping[str, tuple[float, float | None]]
    chi2: float
    dof: int
    noise_scale: float
    n_samples: int
    n_negative: int
    select: Mapping[str, str] = field(default_factory=dict)
    input: str | None = None


@dataclass(frozen=True)
class Sharing:
    """Whether the parts of a joint fit have their shared parameters in common: a test.

    Parameters
    ----------
    parameters : tuple of str
        What is shared.
    growth : float
        chi-squared of the joint fit less that of separate fits, in units of the noise.
    dof : int
        How many parameters the separate fits have more.
    p_value : float or None
        Chance of a growth as large where the parts do share; errors of the parts' own, such as a
        lamp that drifts, are allowed for. None where nothing can be tested.
    refused : bool
        The chance is below 1 %, and where the model does not hold `change` is above the tolerance
        of the verdict, 1 %.
    distance : float or None
        Where the model does not hold and separate estimates decide in place of `growth`: the
        clearest difference between a part and the others, in standard uncertainties.
    distance_dof : float or None
        Degrees of freedom of that uncertainty; None where it is known.
    change : float or None
        Typical change of f by the sharing, as a fraction of f, where separate estimates decide.
    """

    parameters: tuple[str, ...]
    growth: float
    dof: int
    p_value: float | None
    refused: bool
    distance: float | None = None
    distance_dof: float | None = None
    change: float | None = None
