"""How well a fit predicts samples that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError
from gonio.fitting.problem.shared_columns import shared_columns
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.result.noncentrality import noncentrality
from gonio.fitting.result.prediction import predict
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.verdict import ALARM, HIDDEN, TOLERANCE, WORDS, Class, of_f
from gonio.geometry import FloatArray
from gonio.models import Model
from gonio.samples import BRDFSamples

WORSE = 2.0  # times that a fit may err more than on its own samples where no noise is stated
FEW = 8  # samples that decide nothing


@dataclass(frozen=True)
class Score:
    """A fit against samples of another file.

    Parameters
    ----------
    kind : {"fits", "fits_within_shared", "does_not_fit", "undecided"}
        The class, as of a verdict; "class" in documents.
    n : int
        Samples that were predicted.
    typical_error : float
        Typical error of the prediction as a fraction of f, the noise of the samples taken off
        where they state it.
    interval : tuple of float
        95 % interval of `typical_error`.
    bias : float
        Mean of measured less predicted as a fraction of f.
    chi2, dof : float or None
        Of the residuals with the noise of the samples, their shared errors and the uncertainty of
        the prediction; None where no noise is stated.
    p : float or None
        Chance of a chi-squared as large.
    reason : str
        In words, without the class.
    """

    kind: Class
    n: int
    typical_error: float
    interval: tuple[float, float]
    bias: float
    chi2: float | None
    dof: int | None
    p: float | None
    reason: str

    @property
    def line(self) -> str:
        """The score in one line."""
        return f"prediction: {WORDS[self.kind]}: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a JSON document."""
        return {
            "class": self.kind,
            "n_samples": self.n,
            "typical_error": self.typical_error,
            "interval": list(self.interval),
            "bias": self.bias,
            "chi2": self.chi2,
            "dof": self.dof,
            "p": self.p,
            "reason": self.reason,
        }


def score(record: FitRecord, model: Model, samples: BRDFSamples) -> Score:
    """Compare the predictions of a fit with samples.

    Parameters
    ----------
    record : FitRecord
        Of a fit to one BRDF.
    model : Model
    samples : BRDFSamples
        Of one wavelength and channel; cells count by their centroids.

    Raises
    ------
    ConfigurationError
        If the fit is a joint one, or the samples are none.
    """
    if not isinstance(samples, BRDFSamples):
        raise ConfigurationError(
            f"a fit is scored by BRDF samples, not by {type(samples).__name__}; read a file with "
            "gonio.formats.read(file)."
        )
    f = np.broadcast_to(predict(record, model, samples.directions).value, (len(samples),))
    residual = samples.value - f
    bias = float(residual @ f / max(float(f @ f), 1e-300))
    if samples.u_independent is None:
        return _without_noise(record, f, residual, bias)
    by_fit = _prediction_columns(record, model, samples)
    u = samples.u_independent
    alone = _against_noise(f, residual, u, by_fit, bias)
    if alone.kind == "fits" or not samples.shared:
        return alone
    problem = SingleProblem.from_samples(samples, model, n_unknowns=0)
    shared = shared_columns(problem, model.vector(record.values()), f).toarray()
    within = _against_noise(f, residual, u, np.column_stack([by_fit, shared]), bias)
    if within.kind != "fits":
        return within
    return Score(**{**within.__dict__, "kind": "fits_within_shared"})


def _against_noise(
    f: FloatArray, residual: FloatArray, u: FloatArray, columns: FloatArray, bias: float
) -> Score:
    """Residuals against stated noise, and errors with the covariance `columns` columns^T."""
    from scipy import stats

    v = columns / u[:, None]
    inner = np.linalg.inv(np.eye(v.shape[1]) + v.T @ v)
    z = residual / u
    across = v.T @ z
    chi2, n = max(float(z @ z - across @ inner @ across), 0.0), len(f)
    information = max(float(np.sum((f / u) ** 2)), 1e-300)
    # What noise and the other errors are expected to add to the squares is taken off.
    beyond = float(z @ z) - float(np.sum(v**2))
    size = float(np.sqrt(max(beyond - n, 0.0) / information))
    low, high = (float(np.sqrt(x / information)) for x in noncentrality(beyond, n))
    p = float(stats.chi2.sf(chi2, n))
    kind, reason = _class(p, size, high, n)
    return Score(kind, n, size, (low, high), bias, chi2, n, p, reason)


def _class(p: float, size: float, upper: float, n: int) -> tuple[Class, str]:
    if p >= ALARM and n < FEW:
        return "undecided", f"{n} samples cannot tell a right prediction from a wrong one"
    if p >= ALARM and upper > HIDDEN:
        return "undecided", f"the noise may hide an error of {of_f(upper)}"
    if p >= ALARM:
        return "fits", f"no error of the prediction beyond {of_f(upper)}"
    if upper <= TOLERANCE:
        return "fits", f"typically off by {of_f(size)}"
    if size <= TOLERANCE:
        return "undecided", f"an error of {of_f(size)} or so is seen"
    return "does_not_fit", f"typically off by {of_f(size)}"


def _without_noise(record: FitRecord, f: FloatArray, residual: FloatArray, bias: float) -> Score:
    """Residuals beside those of the fit, where the samples state no noise."""
    n = len(f)
    floor = 1e-3 * float(np.mean(f**2))
    size = float(np.sqrt(np.mean(residual**2 / np.maximum(f**2, floor))))
    own = None if record.verdict is None else record.verdict.interval
    text = f"all residuals are {of_f(size)}, and no noise is stated"
    kind: Class = "undecided"
    if size <= TOLERANCE:
        kind = "fits"
    elif own is not None and n >= FEW and size > WORSE * own[1]:
        kind = "does_not_fit"
        text += f"; on its own samples the fit is off by {of_f(own[1])}"
    return Score(kind, n, size, (0.0, size), bias, None, None, None, text)


def _prediction_columns(record: FitRecord, model: Model, samples: BRDFSamples) -> FloatArray:
    """Columns whose products are the covariance that the fit's parameters give the predictions."""
    if record.covariance is None:
        return np.zeros((len(samples), 0))
    w_i, w_r = samples.directions.vectors()
    _, jacobian = model.gradient(w_i, w_r, model.vector(record.values()))
    jacobian = np.broadcast_to(jacobian, (len(samples), jacobian.shape[-1]))
    values, vectors = np.linalg.eigh(np.asarray(record.covariance))
    return np.asarray(jacobian @ (vectors * np.sqrt(np.maximum(values, 0.0))))
