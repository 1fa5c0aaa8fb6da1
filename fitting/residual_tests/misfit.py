"""Whether the residuals of a fit have structure that noise has not: tests of variance components.

Under a true model the standardised residuals are white. Five kinds of error of the model are looked
for: one that is smooth over half and difference angle, one that varies quickly over them, one that
is smooth over viewing direction and angle of incidence, one that varies with the direction of the
half vector on the sample, and a factor of each incidence. Each is a variance component whose score
test is exact for normal noise of any size; Cauchy's rule combines
them. The size of the noise drops out; how it depends on f must be right, so that noise that nobody
stated is taken as sd^2 = a + b f^2 with a and b from the scatter itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.residual_tests.model_errors import error_columns
from gonio.fitting.residual_tests.quadratic_forms import combined
from gonio.fitting.residual_tests.smooth_basis import Columns
from gonio.fitting.residual_tests.standardised import Noise, Standardised, standardise
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.result.verdict import ALARM

MOST = 5_000  # samples that are examined: an error of the model of a tenth of the noise is seen


@dataclass(frozen=True)
class MisfitTest:
    """Whether the residuals have structure that independent noise and shared errors do not make.

    Parameters
    ----------
    p : float
        Chance of structure as clear under a true model: the components combined by Cauchy's rule.
    components : mapping of str to float
        p-value of each kind of error, in words; of the parts of a joint fit their combination. A
        kind that the samples cannot tell from the parameters is left out.
    parts : tuple of float
        p-value of each part of a joint fit, in their order; of one BRDF `p` alone.
    noise : {"stated", "from the residuals"}
        Where the size of the noise comes from, and how it depends on f.
    n, n_all : int
        Samples that were examined, evenly chosen, of so many.
    dof : int
        Degrees of freedom of the residuals that were examined.
    """

    p: float
    components: Mapping[str, float]
    parts: tuple[float, ...]
    noise: Noise
    n: int
    n_all: int
    dof: int

    @property
    def structured(self) -> bool:
        """Whether the structure is clearer than in 99 % of true models."""
        return self.p < ALARM


def misfit_test(minimum: Minimum, *, shared: bool = True) -> MisfitTest | None:
    """Test the residuals of a fit for structure.

    Parameters
    ----------
    minimum : Minimum
        Of a problem of any kind: over one BRDF or several, reduced, with profiled shared errors,
        or penalised.
    shared : bool
        With the errors that samples share in the covariance of the residuals, as `SharedTerm`
        states them; without them they count as errors of the model.

    Returns
    -------
    MisfitTest or None
        None where the residuals are rounding or have fewer than 8 degrees of freedom.

    Examples
    --------
    >>> import numpy as np
    >>> from gonio.fitting.minimum.find import find_minimum
    >>> from gonio.geometry import Directions
    >>> from gonio.models import get
    >>> from gonio.samples import BRDFSamples
    >>> theta = np.tile(np.linspace(0, 1.2, 40), 3)
    >>> directions = Directions(np.repeat([0.1, 0.5, 0.9], 40), 0.0, theta, np.pi)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(120)
    >>> samples = BRDFSamples(directions, 0.1 + noise, np.full(120, 0.01))
    >>> misfit_test(find_minimum(samples, get("lambert"))).structured
    False
    >>> samples = BRDFSamples(directions, 0.1 + 0.1 * theta + noise, np.full(120, 0.01))
    >>> misfit_test(find_minimum(samples, get("lambert"))).structured
    True
    """
    return misfit_test_of(Base.of(minimum, MOST), shared=shared)


def misfit_test_of(base: Base, *, shared: bool = True) -> MisfitTest | None:
    """`misfit_test` where the fit's values and derivatives are at hand; made once."""
    shared = shared and base.shared.shape[1] > 0  # without them both tests are one
    if (MisfitTest, shared) not in base.found:
        base.found[MisfitTest, shared] = _made(base, shared=shared)
    test: MisfitTest | None = base.found[MisfitTest, shared]
    return test


def _made(base: Base, *, shared: bool) -> MisfitTest | None:
    base = base.thinned(MOST)
    left = standardise(base, shared=shared)
    if left is None:
        return None
    found: dict[str, list[float]] = {}
    parts = []
    for where, every in errors_of_parts(base, left):
        own = []
        for columns in every:
            for name, p in left.component_tests(columns, where).items():
                own.append(p)
                found.setdefault(name, []).append(p)
        parts.append(combined(own))
    return MisfitTest(
        p=combined([p for own in found.values() for p in own]),
        components={name: combined(own) for name, own in found.items()},
        parts=tuple(parts),
        noise=left.noise,
        n=left.problem.n,
        n_all=left.n_all,
        dof=left.dof,
    )


def errors_of_parts(base: Base, left: Standardised) -> Iterator[tuple[slice, list[Columns]]]:
    """Samples of each part, and the columns of every kind of error that it may have.

    Parameters
    ----------
    base : Base
        Over the samples of `left`.
    left : Standardised
    """
    w_i, w_r = base.vectors
    for piece, where, _ in left.problem.pieces():
        yield where, error_columns(piece, (w_i[where], w_r[where]), left.level[where])
