"""What a fit gives back: a record a person can read, with a JSON form."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.errors import ConfigurationError, DataError
from gonio.files import write_text
from gonio.fitting.result import document, frames, parts, text
from gonio.fitting.result.correlation import correlation
from gonio.fitting.result.explained import correlation_table
from gonio.fitting.result.html import html
from gonio.fitting.result.memory import Memory, forgotten
from gonio.fitting.result.prediction import Prediction, predict
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.score import Score, score
from gonio.geometry import Directions, FloatArray
from gonio.models import Model, of_fit
from gonio.samples import BRDFSamples

if TYPE_CHECKING:
    import pandas as pd


_OTHERS = {".csv", ".nc", ".toml", ".html", ".png", ".pdf", ".svg", ".tex"}


@dataclass(frozen=True, repr=False)
class FitResult(FitRecord):
    """A fitted model; angles in radians. `FitRecord` says what its fields are.

    Parameters
    ----------
    memory : Memory, optional
        The model, samples and draws, where the fit was made in this process; no file holds them.

    Examples
    --------
    >>> import numpy as np
    >>> from gonio.fitting.fit import fit
    >>> from gonio.samples import BRDFSamples
    >>> theta = np.linspace(0, 1.2, 20)
    >>> noise = 0.001 * np.cos(7 * np.arange(20))
    >>> samples = BRDFSamples(Directions(0.3, 0.0, theta, 0.0), 0.1 + noise)
    >>> result = fit(samples, "lambert")
    >>> print(repr(result))
    <FitResult lambert: rho = 0.3145 ± 0.00051; fits, converged, 20 samples>
    >>> result.predict(Directions(0.1, 0.0, 0.2, 0.0)).value
    array(0.10009537)
    """

    memory: Memory | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        return text.short(self)

    def __str__(self) -> str:
        return text.rendered(text.page(self, self._title()))

    def _repr_html_(self) -> str:
        return html(self, self._title())

    def summary(self) -> str:
        """The printed table with correlations, what the data say of each parameter, and residuals.

        It is what ``gonio fit --explain`` shows.
        """
        pieces = text.page(self, self._title(), explain=True)
        if not self.diagnostics.get("identifiability"):
            pieces += correlation_table(self)
        return text.rendered(pieces)

    def predict(self, directions: Directions) -> Prediction:
        """The fitted model at these directions, with its standard uncertainty.

        Parameters
        ----------
        directions : Directions
            Any shape, radians.

        Returns
        -------
        Prediction
            ``value`` and ``u``, sr^-1. The uncertainty is that of the total covariance through the
            model's derivatives, shared errors included; None where `covariance` is None.

        Raises
        ------
        ConfigurationError
            If the fit is a joint one; take a `part` of it.
        """
        return predict(self, self._model(), directions)

    def score(self, samples: BRDFSamples) -> Score:
        """How well the fit predicts samples that it has not seen.

        Parameters
        ----------
        samples : BRDFSamples
            Of one wavelength and channel; cells count by their centroids.

        Returns
        -------
        Score
            The typical error with its interval, chi-squared by the noise of the samples and the
            uncertainty of the prediction, and a class as of a verdict.

        Raises
        ------
        ConfigurationError
            If the fit is a joint one; take a `part` of it.
        """
        return score(self, self._model(), samples)

    @property
    def residuals(self) -> FloatArray:
        """Measured less fitted value of each sample, over its cell, (N,), sr^-1.

        Raises
        ------
        DataError
            If the result was read from a file: it does not hold the samples.
        """
        if self.memory is None:
            raise forgotten(
                "its samples",
                "fit again, or take samples.value - result.predict(samples.directions).value",
            )
        return self.memory.samples.value - self.memory.fitted()

    def to_dataframe(self) -> pd.DataFrame:
        """One row a parameter: value, stderr, unit, at_bound and the intervals; NaN if unknown."""
        return frames.parameters_frame(self)

    def covariance_frame(self) -> pd.DataFrame:
        """The covariance of all errors with the parameters' names on both sides.

        Raises
        ------
        DataError
            If the fit has none, because a parameter is at a bound or not determined.
        """
        if self.covariance is None:
            raise DataError(
                "this fit has no covariance: a parameter is at a bound or not determined; "
                "see its warnings."
            )
        return frames.matrix_frame(list(self.parameters), self.covariance)

    def correlation_frame(self) -> pd.DataFrame:
        """The correlation of all errors, shared ones included, with names on both sides.

        Raises
        ------
        DataError
            As `covariance_frame`.
        """
        self.covariance_frame()
        matrix = correlation(self)
        assert matrix is not None  # where there is a covariance
        return frames.matrix_frame(matrix.names, matrix.rows)

    def inference_data(self, *, log_likelihood: bool = False) -> Any:
        """The posterior's draws in memory, as arviz takes them; angles in radians.

        Parameters
        ----------
        log_likelihood : bool
            With the group that `arviz.loo` and `arviz.waic` need: log densities of the samples,
            thinned to 200 MB where there are more. They are those of the independent errors, the
            shared errors held at their stated values.

        Returns
        -------
        arviz.InferenceData, or xarray.DataTree from arviz 1 on and where arviz is not installed

        Raises
        ------
        DataError
            If the result was read from a file; the file of draws holds them.
        ConfigurationError
            If no posterior was sampled.
        """
        if self.memory is None:
            raise forgotten(
                "its draws", "give fit(..., draws=PATH) and open that file with arviz.from_netcdf"
            )
        data = self.memory.inference_data(log_likelihood=log_likelihood)
        if data is None:
            raise ConfigurationError(
                "this fit has no posterior to make inference data of; fit with posterior=True."
            )
        return data

    def part(self, name: str) -> FitResult:
        """One part of a joint fit as a fit of its own, its parameters by the model's names.

        Raises
        ------
        ConfigurationError
            If the fit has no part of this name, with the nearest one.
        """
        one = parts.part(self, name)
        if self.memory is None:
            return one
        index = [each.name for each in self.parts].index(name)
        return replace(one, memory=self.memory.part(index))

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data of schema gonio.fit/1, angles in degrees."""
        return document.to_dict(self)

    def to_json(self) -> str:
        """The result as a JSON document, angles in degrees."""
        return document.to_json(self)

    def save(self, path: str | Path) -> None:
        """Write the JSON document, whole or not at all; angles in it are degrees.

        Raises
        ------
        ConfigurationError
            If the name is that of a table, of samples or of a picture.
        """
        if Path(path).suffix.lower() in _OTHERS:
            raise ConfigurationError(
                f"{path}: a fit is saved as JSON; name a file .json. Tables of it are "
                "result.to_dataframe() and 'gonio report FIT.json --csv FILE'.",
                value=path,
            )
        write_text(Path(path), self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> FitResult:
        """Read what `save` wrote, also by earlier versions; angles become radians.

        Raises
        ------
        DataError
            If the file is missing or not a fit of this schema.
        """
        return document.load(Path(path), cls)

    def _model(self) -> Model:
        return self.memory.model if self.memory is not None else of_fit(self)

    def _title(self) -> str:
        try:
            model = self._model()
        except ConfigurationError:  # of a model that this process does not know
            return self.model
        return model.heading
