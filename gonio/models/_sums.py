"""Sums of models: a diffuse base with a lobe of another kind, two specular lobes.

The kernel of a sum is written to a file like the loops around it (docs/adr/0004): numba keeps
machine code only for functions that live in one.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray
from gonio.kernels.arrays import ArrayKernel
from gonio.kernels.generated import generated_module
from gonio.kernels.sources import ingredients, reached
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Lobe, Named

SIGN = "+"
_DIRECTIONS = "xi, yi, zi, xr, yr, zr"
_TEXT = '''# Written by gonio.models; safe to delete.
"""Sum of {n} models.

f = {formula}

Each term has the formula and the parameters of its model.
"""
# Handed in by gonio.models: {terms}.


def kernel({directions}, {parameters}):
    """f and its derivative by every parameter, term by term."""
{calls}
    return (
        {value},
        {derivatives},
    )
'''


def term_names(name: str) -> list[str]:
    """Names of the terms of a sum.

    Raises
    ------
    ConfigurationError
        If a term is empty.

    Examples
    --------
    >>> term_names("lambert + ward")
    ['lambert', 'ward']
    """
    terms = [term.strip() for term in name.split(SIGN)]
    if not all(terms):
        raise ConfigurationError(
            f"the sum {name!r} has an empty term; write the names of two or more models with one "
            f"'{SIGN}' between them, such as 'lambert+ward'.",
            value=name,
        )
    return terms


def added(terms: Sequence[Model]) -> Model:
    """The model whose f is the sum of the terms' f.

    Parameters
    ----------
    terms : sequence of Model
        In the order in which their parameters follow each other.

    Returns
    -------
    Model
        It claims what all terms claim; it has the seams and the lobes of each and no Lambertian
        limit.
    """
    parameters = joined(terms)
    names = [[q.name for q in group] for group in parameters]
    claims = [term.claims for term in terms]
    return Model(
        name=SIGN.join(term.name for term in terms),
        title=" + ".join(term.title for term in terms),
        reference="; ".join(dict.fromkeys(term.reference for term in terms)),
        parameters=tuple(q for group in parameters for q in group),
        kernel=_kernel(terms, names),
        claims=Claims(
            reciprocal=all(c.reciprocal for c in claims),
            non_negative=all(c.non_negative for c in claims),
            isotropic=all(c.isotropic for c in claims),
            seams=tuple(dict.fromkeys(seam for c in claims for seam in c.seams)),
            albedo_at_most=_albedo_at_most(terms, names),
        ),
        validity=_validity(terms),
        lobes=tuple(
            OfTerm(lobe=lobe, names=tuple(zip(term.names, own, strict=True)))
            for term, own in zip(terms, names, strict=True)
            for lobe in term.lobes
        ),
        costly=any(term.costly for term in terms),
        terms=tuple(terms),
    )


def _kernel(terms: Sequence[Model], names: Sequence[Sequence[str]]) -> Callable[..., Any]:
    """The kernel of a sum: compiled where those of all terms are, else of whole arrays."""
    if any(isinstance(term.kernel, ArrayKernel) for term in terms):
        return _of_arrays(terms)
    bound = {f"term_{k}": term.kernel for k, term in enumerate(terms, 1)}
    read, kept = ingredients([f for term in terms for f in reached(term.kernel)])
    module = generated_module("sum", _text(terms, names), read, bound=bound, kept=kept)
    kernel: Callable[..., Any] = module.kernel
    return kernel


def _of_arrays(terms: Sequence[Model]) -> ArrayKernel:
    """The sum of terms of which one is a function of arrays."""
    ends = np.cumsum([0, *(len(term.parameters) for term in terms)])
    own = [slice(a, b) for a, b in itertools.pairwise(ends)]

    def values(w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> FloatArray:
        parts = [t.evaluate(w_i, w_r, p[s], threads=1) for t, s in zip(terms, own, strict=True)]
        return np.asarray(np.sum(parts, axis=0))

    def gradient(w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = [t.gradient(w_i, w_r, p[s], threads=1) for t, s in zip(terms, own, strict=True)]
        f = np.sum([each for each, _ in parts], axis=0)
        return f, np.concatenate([jac for _, jac in parts], axis=1)

    note = " ".join(dict.fromkeys(term.note for term in terms if term.note))
    return ArrayKernel(values, values, gradient, int(ends[-1]), note)


@dataclass(frozen=True, kw_only=True)
class OfTerm(Lobe):
    """A lobe of one term, which knows the parameters by the names that they have there.

    Parameters
    ----------
    lobe : Lobe
    names : tuple of (str, str)
        Name in the term and name in the sum of each parameter of the term.
    """

    lobe: Lobe
    names: tuple[tuple[str, str], ...]

    def _own(self, p: Named) -> Named:
        return {name: p[in_sum] for name, in_sum in self.names}

    def chance(self, p: Named, cos_i: FloatArray) -> ArrayLike:
        return self.lobe.chance(self._own(p), cos_i)

    def draw(self, p: Named, w_i: FloatArray, u: FloatArray) -> FloatArray:
        return self.lobe.draw(self._own(p), w_i, u)

    def density(self, p: Named, w_i: FloatArray, w_r: FloatArray) -> FloatArray:
        return self.lobe.density(self._own(p), w_i, w_r)


def _albedo_at_most(
    terms: Sequence[Model], names: Sequence[Sequence[str]]
) -> tuple[str, ...] | None:
    """What bounds the albedo of the sum, if parameters bound that of every term."""
    bounds: list[str] = []
    for term, own in zip(terms, names, strict=True):
        # A term that may reflect all light leaves nothing for the others.
        if not term.claims.albedo_at_most:
            return None
        in_sum = dict(zip(term.names, own, strict=True))
        bounds += [in_sum[name] for name in term.claims.albedo_at_most]
    return tuple(bounds)


def _validity(terms: Sequence[Model]) -> str:
    """What the terms say of themselves, and what holds for their sum."""
    sentences = [f"{term.name}: {term.validity}" for term in terms]
    sentences.append(
        "Of parameters that scale the same shape, such as two diffuse reflectances, data tell only "
        "the sum."
    )
    if len({term.name for term in terms}) < len(terms):
        sentences.append("Terms of the same model may be exchanged.")
    return " ".join(dict.fromkeys(sentences))


def joined(terms: Sequence[Model]) -> list[tuple[Parameter, ...]]:
    """The parameters of each term, made unique.

    One whose name occurs in several terms carries the number of its term, counted from 1, in name
    and symbol; the others keep theirs.
    """
    count = Counter(q.name for term in terms for q in term.parameters)
    return [
        tuple(_of_term(q, k, term.name, count[q.name] > 1) for q in term.parameters)
        for k, term in enumerate(terms, 1)
    ]


def _of_term(q: Parameter, k: int, term: str, shared: bool) -> Parameter:
    number = f"_{k}" if shared else ""
    return replace(
        q,
        name=f"{q.name}{number}",
        symbol=f"{q.symbol}{number}",
        meaning=f"{q.meaning} (term {k}, {term})",
    )


def _text(terms: Sequence[Model], names: Sequence[Sequence[str]]) -> str:
    """Source of the module that holds the kernel of a sum."""
    numbered = list(enumerate(zip(terms, names, strict=True), 1))
    return _TEXT.format(
        n=len(terms),
        formula=" + ".join(f"{term.name}({', '.join(own)})" for _, (term, own) in numbered),
        terms=", ".join(f"term_{k} of {term.name}" for k, (term, _) in numbered),
        directions=_DIRECTIONS,
        parameters=", ".join(name for own in names for name in own),
        calls="\n".join(
            f"    f_{k} = term_{k}({_DIRECTIONS}, {', '.join(own)})" for k, (_, own) in numbered
        ),
        value=" + ".join(f"f_{k}[0]" for k, _ in numbered),
        derivatives=", ".join(
            f"f_{k}[{j}]" for k, (_, own) in numbered for j in range(1, len(own) + 1)
        ),
    )
