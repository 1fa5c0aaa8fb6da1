"""What a reflectance model is: its parameters, its scalar kernel and the claims it must keep."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import ConfigurationError, unknown_name
from gonio.geometry import Directions, FloatArray
from gonio.kernels import (
    Loops,
    PairLoops,
    default_threads,
    loops_for,
    map_blocks,
    pair_block,
    single_loops_for,
)
from gonio.kernels.arrays import ArrayKernel
from gonio.models import sampling, text
from gonio.models.claims import Claims
from gonio.models.function import Given, array_kernel, declared
from gonio.models.pairs import check_out, components
from gonio.models.parameter import Parameter
from gonio.models.sampling import Cosine, Draws, Lobe

__all__ = ["Claims", "Model", "Parameter"]

Real = TypeVar("Real", np.float32, np.float64)


@dataclass(frozen=True)
class Model:
    """A reflectance model: called with directions and parameters it gives f in sr^-1.

    Parameters
    ----------
    name, title, reference : str
        Name on the command line, full name, and paper with equation and page.
    parameters : tuple of Parameter
        In the order in which the kernel takes them.
    kernel : callable
        kernel(xi, yi, zi, xr, yr, zr, *parameters) -> (f, df/dp_1, ..., df/dp_n) for one pair of
        unit vectors above the horizon, in plain Python and `math`.
    claims : Claims
        What the contract tests hold the model to.
    validity : str
        Where the formula may be trusted, in one or two sentences.
    lobes : tuple of Lobe
        What `sample` draws from. The cosine, which stands here by default, is right for every f
        that is bounded; a lobe that follows f is better.
    costly : bool
        True where f takes a hundred times longer than a closed formula, so that a check looks at
        fewer directions.
    terms : tuple of Model
        Those of which this one is the sum, else empty.
    """

    name: str
    title: str
    reference: str
    parameters: tuple[Parameter, ...]
    kernel: Callable[..., tuple[float, ...]]
    claims: Claims = field(default_factory=Claims)
    validity: str = ""
    lobes: tuple[Lobe, ...] = (Cosine(),)
    costly: bool = False
    terms: tuple[Model, ...] = ()

    @classmethod
    def from_function(
        cls,
        function: Callable[..., Any],
        parameters: Given = None,
        *,
        name: str | None = None,
        **about: Any,
    ) -> Model:
        """A model from a plain function of numpy arrays, without derivatives.

        Parameters
        ----------
        function : callable
            `function(directions, **parameters)` returns f in sr^-1, cosine not included.
            `directions` is a `gonio.geometry.Directions` of n pairs above the horizon: theta_i,
            phi_i, theta_r and phi_r are arrays (n,) in radians, `directions.vectors()` the unit
            vectors (n, 3). The result has n values, or is one number.
        parameters : sequence or mapping, optional
            Records of `Parameter`; or a mapping of name to (default, lower, upper); or names, whose
            range is then 0 to 1 and whose default is that of the function's signature, else 0.5.
            The names of the signature where not given.
        name : str, optional
            Name of the model; that of the function where not given.
        **about
            Other fields of `Model`: title, reference, claims, validity, lobes. Nothing but a value
            that is not negative is claimed where `claims` is not given.

        Returns
        -------
        Model
            Slower than one with a scalar kernel: it is not compiled, and derivatives are found by a
            complex step where `function` carries complex parameters through, else by differences.
            A fit says which in its warnings.

        Raises
        ------
        ConfigurationError
            If the function does not take the parameters by their names, returns another number of
            values or none that are real and finite, or a parameter is declared wrongly.
        DataError
            If the function raises an exception, at the default parameters or later.

        Examples
        --------
        >>> def minnaert(directions, rho, k):
        ...     cosines = np.cos(directions.theta_i) * np.cos(directions.theta_r)
        ...     return rho / np.pi * cosines ** (k - 1)
        >>> model = Model.from_function(minnaert, {"rho": (0.5, 0, 1), "k": (1, 0, 2)})
        >>> round(float(model(Directions(0.0, 0.0, 0.5, 0.0), rho=0.3, k=1.0)), 6)
        0.095493
        """
        chosen = str(name or getattr(function, "__name__", "function"))
        records = declared(function, parameters)
        return cls(
            name=chosen,
            parameters=records,
            kernel=array_kernel(function, records, chosen),
            title=about.pop("title", chosen),
            reference=about.pop("reference", ""),
            claims=about.pop("claims", Claims(reciprocal=False)),
            **about,
        )

    def __call__(self, directions: Directions, **parameters: float) -> FloatArray:
        """BRDF in sr^-1, cosine not included.

        Parameters
        ----------
        directions : Directions
            Pairs of directions in the frame of the sample, any shape.
        **parameters : float
            All parameters by name; those left out take their defaults.

        Returns
        -------
        ndarray
            Shape of `directions`; 0 at and below the horizon.

        Raises
        ------
        ConfigurationError
            If a name is unknown or a value out of range.
        """
        w_i, w_r = directions.vectors()
        return self.evaluate(w_i, w_r, self.vector(parameters))

    @property
    def heading(self) -> str:
        """Title, with the reference where there is one."""
        return f"{self.title} ({self.reference})" if self.reference else self.title

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of the kernel."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def loops(self) -> Loops:
        """The compiled loops over this model's kernel."""
        return loops_for(self.kernel, len(self.parameters))

    def parameter(self, name: str) -> Parameter:
        """The parameter with this name.

        Raises
        ------
        ConfigurationError
            If the model has none, with the nearest name.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise unknown_name("parameter", name, self.names, of=self.name)

    def vector(self, parameters: Mapping[str, float]) -> FloatArray:
        """Checked parameter vector in the kernel's order, defaults filled in."""
        for name in parameters:
            self.parameter(name)
        return np.array([p.check(parameters.get(p.name, p.default)) for p in self.parameters])

    def evaluate(
        self,
        w_i: NDArray[Real],
        w_r: NDArray[Real],
        p: FloatArray,
        *,
        out: NDArray[Real] | None = None,
        threads: int | None = None,
    ) -> NDArray[Real]:
        """f for many pairs of unit vectors and one parameter vector, neither of them checked.

        Parameters
        ----------
        w_i, w_r : ndarray, shape (..., 3)
            Unit vectors that broadcast against each other. Where both are float32, f is computed
            in single precision: a rounding error of 1e-6 to 1e-5 of the lobe, half the memory.
            They are read without a copy where each component is contiguous, as
            `gonio.geometry.unit_vectors` makes them.
        p : ndarray
            Parameter vector as `vector` makes it.
        out : ndarray, optional
            C-contiguous array of the pairs' shape and type that f is written to.
        threads : int, optional
            Threads to use; all cores if not given. The result does not depend on it.

        Returns
        -------
        ndarray, shape (...)
            f in sr^-1, 0 at and below the horizon; `out` where it was given.

        Raises
        ------
        ConfigurationError
            If `out` does not fit.

        Examples
        --------
        >>> from gonio import models
        >>> up = np.array([[0.0, 0.0, 1.0]], np.float32)
        >>> models.get("lambert").evaluate(up, up, np.array([0.5]))
        array([0.15915494], dtype=float32)
        """
        parts, shape = components(w_i, w_r)
        if out is None:
            out = np.empty(shape, parts[0].dtype)
        else:
            check_out(out, shape, parts[0].dtype)
        self._run(self._loops(parts[0].dtype).evaluate, parts, p, [out.reshape(-1)], threads)
        return out

    def gradient(
        self, w_i: NDArray[Real], w_r: NDArray[Real], p: FloatArray, *, threads: int | None = None
    ) -> tuple[NDArray[Real], NDArray[Real]]:
        """f, and its derivatives (..., n_parameters), in one compiled pass; as `evaluate`."""
        parts, shape = components(w_i, w_r)
        out: NDArray[Real] = np.empty(shape, parts[0].dtype)
        jac: NDArray[Any] = np.empty((len(self.parameters), out.size), out.dtype)
        loop = self._loops(out.dtype).evaluate_gradient
        self._run(loop, parts, p, [out.reshape(-1), jac], threads)
        return out, np.moveaxis(jac.reshape(-1, *shape), 0, -1)

    def _loops(self, dtype: np.dtype[Any]) -> Loops | PairLoops:
        """The loops for directions of this type."""
        if dtype == np.float32:
            return single_loops_for(self.kernel, len(self.parameters))
        return self.loops

    def _run(
        self,
        loop: Callable[..., None],
        parts: Sequence[NDArray[Any]],
        p: FloatArray,
        outputs: Sequence[NDArray[Any]],
        threads: int | None,
    ) -> None:
        """Call a loop on blocks of pairs; the last axis of each output counts pairs."""
        n = parts[0].size
        threads = threads or default_threads()
        vector = np.array(p, float)
        map_blocks(
            lambda s, e: loop(
                *(part[s:e] for part in parts), vector, *(each[..., s:e] for each in outputs)
            ),
            n,
            threads=threads,
            block=pair_block(n, threads, costly=self.costly),
        )

    def sample(self, w_i: ArrayLike, p: ArrayLike, rng: np.random.Generator) -> Draws:
        """Draw one direction of reflection for each direction of incidence.

        Parameters
        ----------
        w_i : array_like, shape (..., 3)
            Unit vectors towards the light, above the horizon.
        p : array_like
            Parameter vector as `vector` makes it.
        rng : numpy.random.Generator
            Source of all randomness.

        Returns
        -------
        Draws
            Directions, weights f cos(theta_r)/density and densities. The mean weight over all
            draws, lost ones included, is the directional albedo.

        Raises
        ------
        DataError
            If w_i holds no unit vectors above the horizon.
        ConfigurationError
            If p has not one value for each parameter.

        Examples
        --------
        >>> from gonio import models
        >>> ward = models.get("ward_gmd")
        >>> p = ward.vector({"rho_d": 0.2, "rho_s": 0.3})
        >>> light = np.tile([0.6, 0.0, 0.8], (20_000, 1))
        >>> draws = ward.sample(light, p, np.random.default_rng(1))
        >>> round(float(draws.weight.mean()), 2)
        0.5
        """
        i, vector, named = sampling.light(w_i), *self._named(p)
        flat = i.reshape(-1, 3)
        w_r = sampling.drawn(self.lobes, named, flat, rng.random((3, len(flat))))
        density = sampling.mixed_density(self.lobes, named, flat, w_r)
        reflected = self.evaluate(flat, w_r, vector) * w_r[:, 2]
        weight = np.divide(reflected, density, out=np.zeros(len(flat)), where=density > 0)
        shape = i.shape[:-1]
        return Draws(w_r.reshape(i.shape), weight.reshape(shape), density.reshape(shape))

    def density(self, w_i: ArrayLike, w_r: ArrayLike, p: ArrayLike) -> FloatArray:
        """Probability density with which `sample` draws w_r, in sr^-1; 0 below the horizon.

        Parameters
        ----------
        w_i, w_r : array_like, shape (..., 3)
            Unit vectors that broadcast against each other; w_i lies above the horizon.
        p : array_like
            Parameter vector as `vector` makes it.

        Returns
        -------
        ndarray, shape (...)
            Its integral over the upper hemisphere is 1 less the share of draws that are lost.

        Raises
        ------
        DataError, ConfigurationError
            As `sample`.
        """
        i, r = sampling.pairs(w_i, w_r)
        _, named = self._named(p)
        density = sampling.mixed_density(self.lobes, named, i.reshape(-1, 3), r.reshape(-1, 3))
        return density.reshape(i.shape[:-1])

    def _named(self, p: ArrayLike) -> tuple[FloatArray, dict[str, float]]:
        """A parameter vector, and its values by name."""
        vector = np.asarray(p, float)
        if vector.shape != (len(self.parameters),):
            raise ConfigurationError(
                f"p has shape {vector.shape}; {self.name} takes the {len(self.parameters)} values "
                f"{', '.join(self.names)}, as its method vector() makes them.",
                value=p,
            )
        return vector, dict(zip(self.names, vector.tolist(), strict=True))

    def plain(self, w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> tuple[float, ...]:
        """The kernel run by the Python interpreter for one pair: the compiled code's twin."""
        if w_i[2] <= 0 or w_r[2] <= 0:
            return (0.0,) * (1 + len(self.parameters))
        arguments = [float(v) for v in (*w_i, *w_r, *p)]
        return self.kernel(*arguments)

    def __repr__(self) -> str:
        return f"<Model {self.name}({', '.join(self.names)}): {self.title}>"

    def __str__(self) -> str:
        return text.page(self.describe(), [p.unit for p in self.parameters])

    def _repr_html_(self) -> str:
        return text.html(self.describe(), [p.unit for p in self.parameters])

    @property
    def functions(self) -> list[Callable[..., Any]]:
        """The functions that someone wrote for this model: one, or those of the terms of a sum."""
        if self.terms:
            return [function for term in self.terms for function in term.functions]
        return [self.kernel.function if isinstance(self.kernel, ArrayKernel) else self.kernel]

    @property
    def note(self) -> str:
        """What a fit should say of how the model is computed; mostly nothing."""
        return self.kernel.note if isinstance(self.kernel, ArrayKernel) else ""

    @property
    def documentation(self) -> str | None:
        """Docstring of the file with the kernel, else of the function."""
        function = self.functions[0]
        module = inspect.getmodule(self.kernel if self.terms else function)
        if module is None or module.__name__ == "__main__" or not inspect.getdoc(module):
            return inspect.getdoc(function)
        return inspect.getdoc(module)

    def describe(self) -> dict[str, Any]:
        """The model as plain data, for --json and documentation."""
        return {
            "name": self.name,
            "title": self.title,
            "reference": self.reference,
            "validity": self.validity,
            "documentation": self.documentation,
            "parameters": [
                {
                    "name": p.name,
                    "symbol": p.symbol,
                    "meaning": p.meaning,
                    "unit": p.file_unit,
                    "default": _shown(p.to_file(p.default)),
                    "lower": _shown(p.to_file(p.lower)),
                    "upper": _shown(p.to_file(p.upper)),
                }
                for p in self.parameters
            ],
        }


def _shown(value: float) -> float:
    """The value to 15 digits, which take back the rounding of degrees to radians and back."""
    return float(f"{value:.15g}")
