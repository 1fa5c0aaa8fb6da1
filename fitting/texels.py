"""`fit_texels`: one small fit after another, for maps of materials."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import DataError
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.unknowns import Reported
from gonio.geometry import Directions, FloatArray
from gonio.kernels import TexelLoops, map_blocks, texel_loops_for
from gonio.models import Model, Parameter
from gonio.models import get as get_model
from gonio.models._fewer import fewer_parameters
from gonio.wording import counted

STATUS = ("converged", "not_converged", "no_data")  # in the order of the compiled loop's numbers
BLOCK = 256  # texels that are fitted in one call
LANES = 8  # numbers of the widest SIMD registers; samples are padded to a multiple of it
GRID = {1: 9, 2: 5}  # points along each nonlinear parameter, by how many of them there are
COARSE = 3  # for more of them, and where each texel needs a grid of its own

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TexelFit:
    """Fitted parameters of every texel; arrays of T texels and P parameters.

    Parameters
    ----------
    model : str
    names : tuple of str
        Of the parameters, in the order of the columns.
    parameters : ndarray, shape (T, P)
        Python units (radians for angles); NaN where the texel has no data.
    stderr : ndarray, shape (T, P)
        Standard uncertainty by the noise alone (`gonio.fit` allows for misfit as well); NaN at a
        bound, where the data do not determine the parameter, where it is fixed, and
        where the fit did not converge.
    chi2 : ndarray, shape (T,)
        Weighted sum of squares of the residuals.
    n_samples : ndarray of int32, shape (T,)
        Samples that were used.
    status : ndarray of int8, shape (T,)
        Index into `STATUS`: 0 converged, 1 not_converged, 2 no_data: not more usable samples than
        parameters that are fitted.
    at_bound : ndarray of int8, shape (T, P)
        -1 on the lower bound, 1 on the upper one, else 0.
    determined : ndarray of bool, shape (T, P)
        Whether the data say anything about the parameter; False where it is fixed.
    """

    model: str
    names: tuple[str, ...]
    parameters: FloatArray
    stderr: FloatArray
    chi2: FloatArray
    n_samples: NDArray[np.int32]
    status: NDArray[np.int8]
    at_bound: NDArray[np.int8]
    determined: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.status)

    def count(self, status: str) -> int:
        """How many texels have this status."""
        return int(np.count_nonzero(self.status == STATUS.index(status)))


def fit_texels(
    directions: Directions,
    values: ArrayLike,
    model: str | Model,
    *,
    u: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    fixed: Mapping[str, float] | None = None,
    tied: Mapping[str, str] | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> TexelFit:
    """Fit a model to every texel of a stack of BRDF values.

    Parameters
    ----------
    directions : Directions
        Shape (N,) where all texels are seen from the same directions, else (T, N).
    values : array_like, shape (T, N)
        BRDF of each texel in sr^-1. Samples that are not finite, or at or below the horizon, are
        left out.
    model : str or Model
    u : array_like, optional
        Standard uncertainty of the values, sr^-1: a number or of shape (N,), (T, 1) or (T, N). A
        sample whose uncertainty is NaN is left out. Where it is not given the scatter about the
        fit is the measure of the noise.
    mask : array_like of bool, shape (N,) or (T, N), optional
        True for samples to leave out.
    fixed : mapping of str to float, optional
        Parameters that are no unknowns, with their values, radians for angles. Code is compiled
        for these values, which takes some seconds at the first call.
    tied : mapping of str to str, optional
        Parameters that take the value of another one: `{"alpha_y": "alpha_x"}`.
    threads : int, optional
        The result does not depend on it.
    progress : callable, optional
        Called with (texels done, texels in all).

    Returns
    -------
    TexelFit

    Raises
    ------
    ConfigurationError
        For an unknown model, or parameters that cannot be fixed or tied so.
    DataError
        If shapes do not fit, an uncertainty is not positive, or a texel has not more samples than
        parameters are fitted.

    Notes
    -----
    The same least squares as `gonio.fit` with these uncertainties, in another way: the parameters
    in which f is linear are solved for on a coarse grid of the others, and from its best point
    damped Gauss-Newton steps lead down inside the bounds. There are no profiles of chi-squared,
    no derivatives are checked, and rival minima are not looked for: what may be afforded once may
    not be a million times. Take some texels to `gonio.fit` before you trust a map.

    Examples
    --------
    >>> theta_r = np.linspace(-1.2, 1.2, 40)
    >>> seen = Directions(0.4, 0.0, np.abs(theta_r), np.where(theta_r > 0, np.pi, 0.0))
    >>> ward = get_model("ward_isotropic")
    >>> chosen = [{"rho_d": 0.2, "rho_s": s, "alpha": 0.15} for s in (0.05, 0.10)]
    >>> stack = np.stack([ward(seen, **p) for p in chosen])
    >>> fit_texels(seen, stack, "ward_isotropic").parameters.round(6).tolist()
    [[0.2, 0.05, 0.15], [0.2, 0.1, 0.15]]
    """
    chosen = get_model(model)
    constraints = Constraints.of(chosen, fixed, tied)
    stack = _Stack.checked(directions, values, u, mask)
    unknowns, arguments, reported = constraints.unknowns(chosen)
    if stack.shape[1] <= len(unknowns):
        raise DataError(
            f"{counted(stack.shape[1], 'sample')} a texel cannot determine the "
            f"{counted(len(unknowns), 'free parameter' if constraints else 'parameter')} of "
            f"{chosen.name}; give at least "
            f"{len(unknowns) + 1}."
        )
    kernel = chosen.kernel
    if constraints:
        kernel = fewer_parameters(
            kernel, tuple(arguments.source.tolist()), tuple(arguments.values.tolist())
        )
    result = _empty(chosen.name, unknowns, stack.shape[0])
    work = _Work.of(kernel, unknowns, stack)
    done, lock = 0, Lock()

    def run(a: int, b: int) -> None:
        nonlocal done
        work.fit(stack, a, b, result)
        if progress is not None:
            with lock:
                done += b - a
                progress(done, stack.shape[0])

    map_blocks(run, stack.shape[0], threads=threads, block=BLOCK)
    return _all_parameters(result, reported) if constraints else result


@dataclass(frozen=True)
class _Stack:
    """Checked data of all texels, read block by block: a stack may be as large as the memory."""

    directions: Directions
    values: NDArray[np.floating]
    u: FloatArray | None
    mask: NDArray[np.bool_] | None
    shape: tuple[int, int]

    @classmethod
    def checked(
        cls, directions: Directions, values: ArrayLike, u: ArrayLike | None, mask: ArrayLike | None
    ) -> _Stack:
        given = np.asanyarray(values)
        if given.ndim != 2 or given.dtype.kind not in "fiu":
            raise DataError(
                f"values are an array of {given.dtype} and shape {given.shape}; give real numbers "
                "of shape (texels, samples)."
            )
        t, n = given.shape
        if directions.shape not in ((n,), (t, n)):
            raise DataError(
                f"directions of shape {directions.shape} do not belong to values of shape {(t, n)};"
                f" give {(n,)} for all texels or {(t, n)} for each."
            )
        if mask is not None:
            mask = np.asarray(mask)
            if mask.dtype != bool or mask.shape not in ((n,), (t, n)):
                raise DataError(
                    f"mask is an array of {mask.dtype} and shape {mask.shape}; give booleans "
                    f"of shape {(n,)} or {(t, n)}, True for samples to leave out."
                )
        if u is not None:
            u = np.asarray(u, float)
            if u.shape not in ((), (n,), (t, 1), (t, n)):
                raise DataError(
                    f"u has shape {u.shape}; give a number or shape {(n,)}, {(t, 1)} or {(t, n)}."
                )
            if np.any(u <= 0):
                raise DataError(
                    "u must be positive; give NaN for a sample to leave out.",
                    value=float(np.min(u)),
                )
        return cls(directions, given, u, mask, (t, n))

    @property
    def common_directions(self) -> bool:
        """Whether all texels are seen from the same directions."""
        return len(self.directions.shape) == 1

    def angles(self, a: int, b: int) -> FloatArray:
        """theta_i, phi_i, theta_r, phi_r (texels, 4, N); one texel where all are alike."""
        t, shape = (1, self.shape[1:]) if self.common_directions else (b - a, self.shape)
        out = np.empty((t, 4, self.shape[1]))
        for k, name in enumerate(("theta_i", "phi_i", "theta_r", "phi_r")):
            angle = np.broadcast_to(getattr(self.directions, name), shape)
            out[:, k] = angle if self.common_directions else angle[a:b]
        return out

    def weights(self, a: int, b: int) -> FloatArray:
        """Inverse variances (1 or texels, N); 0 for samples that are left out."""
        weight = np.ones((1, self.shape[1]))
        if self.u is not None:
            some = self.u[a:b] if self.u.ndim == 2 else self.u
            weight = np.nan_to_num(1 / some**2) * weight
        if self.mask is not None:
            weight = np.where(self.mask[a:b] if self.mask.ndim == 2 else self.mask, 0.0, weight)
        return np.ascontiguousarray(weight)


@dataclass(frozen=True)
class _Work:
    """The compiled loops of a model, with all that does not depend on the texel."""

    loops: TexelLoops
    common: tuple[FloatArray, FloatArray, FloatArray] | None
    width: int
    grid: FloatArray
    linear: NDArray[np.int64]
    lower: FloatArray
    upper: FloatArray
    log: NDArray[np.bool_]
    known_noise: bool

    @classmethod
    def of(
        cls, kernel: Callable[..., Any], parameters: tuple[Parameter, ...], stack: _Stack
    ) -> _Work:
        work = cls(
            texel_loops_for(kernel, len(parameters)),
            None,
            -(-stack.shape[1] // LANES) * LANES,
            _grid(parameters, coarse=not stack.common_directions),
            np.array([j for j, q in enumerate(parameters) if q.linear], np.int64),
            np.array([q.lower for q in parameters]),
            np.array([q.upper for q in parameters]),
            np.array([q.scale == "log" for q in parameters]),
            stack.u is not None,
        )
        if not stack.common_directions:
            return work
        kernel_angles, lit, basis = work.room()
        work.loops.directions(stack.angles(0, 1)[0], np.empty((6, work.width)), kernel_angles, lit)
        columns = np.empty((1 + len(parameters), work.width))
        work.loops.grid_basis(kernel_angles, work.grid, work.linear, columns, basis)
        return replace(work, common=(kernel_angles, lit, basis))

    def room(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What directions say, which of them are lit, and the basis of a texel, to be filled."""
        basis = np.empty((len(self.grid), 2 + len(self.linear), self.width))
        return np.empty((self.loops.KEPT, self.width)), np.empty(self.width), basis

    def fit(self, stack: _Stack, a: int, b: int, result: TexelFit) -> None:
        """Fit the texels a to b."""
        if self.common is None:
            angles = stack.angles(a, b)
            kernel_angles, lit, basis = self.room()
        else:
            angles = np.empty((0, 4, 0))
            kernel_angles, lit, basis = self.common[0], self.common[1], self.common[2].copy()
        values = np.ascontiguousarray(stack.values[a:b], float)
        self.loops.fit_texels(
            kernel_angles, angles, lit, stack.weights(a, b), values, self.grid, basis, self.linear,
            self.lower, self.upper, self.log, self.known_noise, result.parameters[a:b],
            result.stderr[a:b], result.chi2[a:b], result.status[a:b], result.determined[a:b],
            result.at_bound[a:b], result.n_samples[a:b],
        )  # fmt: skip


def _grid(parameters: tuple[Parameter, ...], *, coarse: bool) -> FloatArray:
    """Points to start from (M, P): a grid of the nonlinear parameters, amplitudes at 0."""
    others = [j for j, q in enumerate(parameters) if not q.linear]
    n = COARSE if coarse else GRID.get(len(others), COARSE)
    axes = []
    for j in others:
        q = parameters[j]
        low, high = q.start or (q.lower, q.upper)
        low, high = max(low, q.lower), min(high, q.upper)
        if low >= high:  # a tie may leave bounds outside the range of starting values
            low, high = q.lower, q.upper
        axes.append(np.geomspace(low, high, n) if q.scale == "log" else np.linspace(low, high, n))
    rest = np.array([min(max(0.0, q.lower), q.upper) for q in parameters])
    grid = np.tile(rest, (n ** len(others), 1))
    grid[:, others] = list(itertools.product(*axes))
    return grid


def _empty(model: str, parameters: tuple[Parameter, ...], t: int) -> TexelFit:
    """A result to be filled in."""
    p = len(parameters)
    return TexelFit(
        model=model,
        names=tuple(q.name for q in parameters),
        parameters=np.empty((t, p)),
        stderr=np.empty((t, p)),
        chi2=np.empty(t),
        n_samples=np.empty(t, np.int32),
        status=np.empty(t, np.int8),
        at_bound=np.empty((t, p), np.int8),
        determined=np.empty((t, p), np.bool_),
    )


def _all_parameters(fitted: TexelFit, reported: tuple[Reported, ...]) -> TexelFit:
    """The result of the unknowns with a column for each parameter of the model."""
    columns = np.array([-1 if q.unknown is None else q.unknown for q in reported])
    fixed = columns < 0
    every = replace(
        fitted,
        names=tuple(q.parameter.name for q in reported),
        parameters=fitted.parameters[:, columns],
        stderr=fitted.stderr[:, columns],
        at_bound=fitted.at_bound[:, columns],
        determined=fitted.determined[:, columns],
    )
    every.parameters[:, fixed] = [q.value for q in reported if q.value is not None]
    every.parameters[fitted.status == STATUS.index("no_data")] = np.nan
    every.stderr[:, fixed] = np.nan
    every.at_bound[:, fixed], every.determined[:, fixed] = 0, False
    return every
