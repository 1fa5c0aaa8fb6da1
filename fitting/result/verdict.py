"""The verdict on a fit: whether the model describes the samples, in one line and as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ALARM = 0.01  # chance below which an error is seen: that many true models raise an alarm
TOLERANCE = 0.01  # of f: error up to which a model fits where nothing is stated
HIDDEN = 0.2  # of f: an error as large that the noise may hide leaves all undecided
Class = Literal["fits", "fits_within_shared", "does_not_fit", "undecided"]
WORDS = {
    "fits": "fits",
    "fits_within_shared": "fits within the stated shared errors",
    "does_not_fit": "does not fit",
    "undecided": "undecided",
}


def per_cent(fraction: float) -> str:
    """A fraction in words; one that is many times the whole is no percentage.

    Examples
    --------
    >>> per_cent(0.0064), per_cent(3.5), per_cent(2.3e5)
    ('0.64 %', '350 %', '2.3e+05 times')
    """
    if fraction >= 10:
        return f"{fraction:.2g} times"
    return f"{100 * fraction:.2g} %" if fraction < 1 else f"{100 * fraction:.0f} %"


def of_f(fraction: float) -> str:
    """A fraction of f in words.

    Examples
    --------
    >>> of_f(0.0064), of_f(2.3e5)
    ('0.64 % of f', '2.3e+05 times f')
    """
    return per_cent(fraction) + (" f" if fraction >= 10 else " of f")


@dataclass(frozen=True)
class Verdict:
    """Whether the model describes the samples.

    Parameters
    ----------
    kind : {"fits", "fits_within_shared", "does_not_fit", "undecided"}
        The class; "class" in documents.
    p : float or None
        Chance of residuals as large or as structured where the model is exactly true: the test of
        an exact fit. Of 10^5 samples it rejects every model.
    typical_misfit : float or None
        Typical error of the model as a fraction of f: the root of the excess variance of the
        residuals over the noise. None where it is not known.
    interval : tuple of float, or None
        95 % interval of `typical_misfit`.
    tolerance : float
        Error of the model, as a fraction of f, up to which it fits.
    reason : str
        Why, in words, without the class.
    where : str or None
        Where the model is off by most.
    most : float or None
        Measured less fitted there, as a fraction of f.
    explained : float or None
        Share of the variance of f beyond the noise that the model explains; None where f does not
        vary beyond the noise, or the model fits.
    worse_than_lambert : bool
        Whether incidences that the fit has not seen are predicted better by a constant.
    """

    kind: Class
    p: float | None
    typical_misfit: float | None
    interval: tuple[float, float] | None
    tolerance: float
    reason: str
    where: str | None = None
    most: float | None = None
    explained: float | None = None
    worse_than_lambert: bool = False

    @property
    def fits(self) -> bool:
        """Whether the class is one of the first two."""
        return self.kind in ("fits", "fits_within_shared")

    @property
    def useful(self) -> bool:
        """Whether the model explains half of what f does, and predicts better than a constant."""
        return (self.explained is None or self.explained >= 0.5) and not self.worse_than_lambert

    @property
    def line(self) -> str:
        """The verdict in one line.

        Examples
        --------
        >>> Verdict("fits", 0.4, 0.0, (0.0, 0.004), 0.01, "no error of the model is seen").line
        'verdict: fits: no error of the model is seen'
        """
        return f"verdict: {WORDS[self.kind]}: {self.reason}"

    def to_dict(self) -> dict[str, object]:
        """Plain data for a JSON document."""
        return {
            "class": self.kind,
            "p": self.p,
            "typical_misfit": self.typical_misfit,
            "interval": None if self.interval is None else list(self.interval),
            "tolerance": self.tolerance,
            "reason": self.reason,
            "where": self.where,
            "most": self.most,
            "explained": self.explained,
            "worse_than_lambert": self.worse_than_lambert,
        }

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> Verdict:
        """The verdict that `to_dict` wrote."""
        values = dict(data)
        values["kind"] = values.pop("class")
        if values["interval"] is not None:
            values["interval"] = tuple(values["interval"])  # type: ignore[arg-type]
        return cls(**values)  # type: ignore[arg-type]
