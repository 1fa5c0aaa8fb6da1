"""What a least-squares problem answers, whatever it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.losses import Loss
from gonio.fitting.problem.noise_law import NoiseLaw
from gonio.fitting.problem.unknowns import KernelParameters, Reported
from gonio.geometry import Directions, FloatArray
from gonio.models import Model, Parameter
from gonio.samples import BRDFSamples, Cells

Weights = Literal["none", "cos", "coscos", "relative", "sd"]
ProfiledDraw = tuple[str, int | None, float, float]  # see `Problem.profiled_draws`


class Problem(Protocol):
    """Residuals, weights and derivatives of BRDF samples and a model, as functions of unknowns.

    `SingleProblem` is over one BRDF, `ReducedProblem` one whose parameters are in part fixed or
    tied, `JointProblem` over several BRDFs, `NuisanceProblem` one that profiles shared errors, and
    `PenalisedProblem` one whose parameters other data hold near a centre. N is the number of
    samples and P that of the unknowns.
    """

    # ------------------------------------------------------------------ what it is made of

    @property
    def samples(self) -> BRDFSamples:
        """The samples, in the order of every array of length N."""

    @property
    def model(self) -> Model:
        """The model, with all its parameters."""

    @property
    def name(self) -> str:
        """Name of the model."""

    @property
    def n(self) -> int:
        """Number of samples N."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns with their bounds, in the order of every parameter vector."""

    @property
    def reported(self) -> tuple[Reported, ...]:
        """Every parameter that a result states, the unknowns and those fixed or tied."""

    @property
    def weights(self) -> Weights:
        """What each residual is multiplied by."""

    @property
    def law(self) -> Loss:
        """The loss that is minimised."""

    @property
    def threads(self) -> int | None:
        """Worker threads; no result depends on them."""

    @property
    def w_i(self) -> FloatArray:
        """Unit vectors towards the light, (N, 3)."""

    @property
    def cells(self) -> Cells:
        """Members over which the model is integrated; one a sample where samples are points."""

    @property
    def cos_theta_r(self) -> FloatArray:
        """Cosines of the viewing angles, of a cell at its centroid, (N,)."""

    @property
    def inverse_variance(self) -> FloatArray:
        """Squares of the factors on the residuals, (N,)."""

    # ------------------------------------------------------------------ what kind of problem it is

    @property
    def quadratic(self) -> bool:
        """Whether the loss is chi-squared, quadratic in the linear parameters."""

    @property
    def finds_scale(self) -> bool:
        """Whether the loss needs the size of the noise and the samples do not state it."""

    @property
    def weights_follow_model(self) -> bool:
        """Whether the weights depend on the model's values, so that a fit must be repeated."""

    @property
    def noise_laws(self) -> tuple[NoiseLaw | None, ...]:
        """For each part the law by which stated uncertainties follow the readings, or None."""

    @property
    def sum_limit(self) -> FloatArray:
        """Coefficients c, (P,), of the limit c . p <= 1 on reflectances; 0 where there is none."""

    @property
    def terms_of_sum(self) -> list[tuple[str, NDArray[np.int64]]]:
        """Models that this one is the sum of, with the indices of their parameters."""

    @property
    def kernel_parameters(self) -> KernelParameters | None:
        """How unknowns fill the arguments of the model's kernel.

        None where the problem is more than one model with independent noise and chi-squared, so
        that sums over the kernel alone do not give its likelihood.
        """

    @property
    def independent(self) -> Problem:
        """The problem whose likelihood holds independent errors alone."""

    @property
    def profiled(self) -> tuple[str, ...]:
        """Names of the shared errors that the likelihood holds; the others are propagated."""

    # ------------------------------------------------------------------ values and sums

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Checked vector of the unknowns by name, defaults filled in."""

    def values(self, p: FloatArray, cells: Cells | None = None) -> FloatArray:
        """Expectation of every sample, (N,), sr^-1; over other cells where given."""

    def jacobian(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Expectations (N,) and their derivatives (N, P)."""

    def variance(self, f: FloatArray | None = None, *, sharing: bool = False) -> FloatArray:
        """Variance by independent errors, (N,), where expectations are f, or as stated.

        `sharing` counts the noise of a standard's frame once for each image that uses it.
        """

    def chi2(self, p: FloatArray) -> float:
        """The loss: the sum of squared weighted residuals, or what stands in its place."""

    def batch_chi2(self, batch: FloatArray) -> FloatArray:
        """The loss for each parameter vector of a batch (B, P), shape (B,)."""

    def normal_equations(self, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """chi2, J^T W r and J^T W J at p.

        For another loss: the loss, minus half its slope, and a curvature that is not negative.
        """

    def products(self, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        """Weighted sums of products of [residual, df/dp_1, ...] at each point, (B, R, R).

        `rows` (R,) are the columns that are wanted; 0 is the residual and comes first.
        """

    def weighted(self, columns: FloatArray) -> FloatArray:
        """Columns (N, k) times the inverse covariance of the samples."""

    def profiled_draws(self, p: FloatArray, informed: NDArray[np.bool_]) -> list[ProfiledDraw]:
        """Name, group, estimate and standard uncertainty of every profiled draw where there is one.

        `informed` (P,) are the free unknowns that have an effect on the data at the minimum p.
        """

    def profiled_columns(self) -> FloatArray:
        """Change of the samples for one standard deviation of every profiled draw, (N, draws)."""

    def profiled_change(self) -> FloatArray:
        """What the profiled draws, at their estimates, add to the expectations, (N,)."""

    def shared_changes(self, p: FloatArray) -> list[FloatArray]:
        """Change (N,) of the samples by one standard deviation of each of their shared errors."""

    def model_at(self, directions: Directions, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and derivatives of the model at other directions (M,)."""

    # ------------------------------------------------------------------ problems made from this one

    def with_parameters(self, parameters: tuple[Parameter, ...]) -> Problem:
        """The problem with other bounds of its unknowns."""

    def with_weights(self, inverse_variance: FloatArray) -> Problem:
        """The problem with other squared factors on the residuals."""

    def as_least_squares(self, p: FloatArray | None = None) -> Problem:
        """The problem with chi-squared as its loss.

        With the minimum p of another loss: values and weights are such that its residuals are those
        that the loss sees, and that its minimum is p (`Loss.pseudo_residuals`).
        """

    def reweighted(self, p: FloatArray | None) -> Problem:
        """The problem with weights, and the scale of its loss, at the model's values for p.

        As stated where p is None.
        """

    def with_noise_law(self, p: FloatArray) -> Problem:
        """The problem with weights at the model's values where u follows the readings.

        Whether it does is seen by the model's values for p; `reweighted` then takes the weights.
        """

    def with_directions(
        self, *, shift: FloatArray | None = None, turn: float | FloatArray = 0.0
    ) -> Problem:
        """The problem with its directions elsewhere.

        Parameters
        ----------
        shift : ndarray, shape (N, 3), optional
            Change of the viewing directions of a sample's members, tangent vectors in radians.
        turn : float or ndarray, shape (N,)
            Turn of the sample about its normal, radians: seen from a sample that lies turned
            counter-clockwise both azimuths are smaller.
        """

    def pieces(self) -> list[tuple[Problem, slice, NDArray[np.int64]]]:
        """Problems of which this is the sum, with the indices of their samples and unknowns.

        A problem over one BRDF is its own only piece.
        """

    def around(self, p: FloatArray, h: FloatArray, j: int) -> tuple[Problem, NDArray[np.int64]]:
        """A problem in which unknown j alone is followed, and the indices of its unknowns here.

        p and h are a minimum and J^T W J there. Over one BRDF it is the problem itself.
        """

    def at(self, index: NDArray[np.int64]) -> Problem:
        """The problem of these samples alone, with their cells and weights."""

    def subset(self, n: int) -> Problem:
        """At most n samples, taken at their centroids, for starting values."""
