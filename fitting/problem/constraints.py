"""Parameters that a fit holds fixed or ties to others, and the unknowns that are left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gonio.errors import ConfigurationError, unknown_name
from gonio.fitting.problem.unknowns import KernelParameters, Reported, sum_limit
from gonio.models import Model, Parameter


@dataclass(frozen=True)
class Constraints:
    """Checked constraints on the parameters of a model; `Constraints.of` checks them.

    Parameters
    ----------
    fixed : mapping of str to float
        Values that are no unknowns, in the unit of Python.
    tied : mapping of str to str
        Parameters that take the value of another one, which is tied to none.
    """

    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: Model,
        fixed: Mapping[str, float] | None = None,
        tied: Mapping[str, str] | None = None,
    ) -> Constraints:
        """Constraints on a model, with chains of ties followed to their end.

        Raises
        ------
        ConfigurationError
            For an unknown name, a value outside the bounds, a name that is fixed and tied, a tie
            between units, ties in a circle, or where nothing is left to fit.

        Examples
        --------
        >>> from gonio.models import get
        >>> Constraints.of(get("ward"), tied={"alpha_y": "alpha_x"}).tied
        {'alpha_y': 'alpha_x'}
        """
        values, ties = dict(fixed or {}), dict(tied or {})
        for how, names in (("fixed", values), ("tied", [*ties, *ties.values()])):
            for name in names:
                if name not in model.names:
                    raise unknown_name(f"{how} parameter", name, model.names, of=model.name)
        for name in values:
            if name in ties:
                raise ConfigurationError(
                    f"{name} is fixed and tied at once; leave one of the two out.", value=name
                )
        ends = {name: _end(model, name, ties) for name in ties}
        held = {name: model.parameter(name).check(value) for name, value in values.items()}
        for name, end in ends.items():
            if end in held:
                model.parameter(name).check(held[end])
        if len(held) + len(ends) == len(model.names) and all(e in held for e in ends.values()):
            raise ConfigurationError(
                f"all parameters of {model.name} are fixed or tied to fixed ones: nothing is left "
                "to fit; leave one of them free.",
                value=sorted(held),
            )
        constraints = cls(held, ends)
        _check_sum(model, constraints)
        return constraints

    def __bool__(self) -> bool:
        return bool(self.fixed or self.tied)

    def refuse(self, names: Mapping[str, object] | None, what: str) -> None:
        """Refuse starting values or priors of parameters that are no unknowns.

        Parameters
        ----------
        names : mapping or None
            By the names of parameters, perhaps with a part in brackets.
        what : str
            "starting value" or "prior".

        Raises
        ------
        ConfigurationError
        """
        for name in names or {}:
            base = name.partition("[")[0]
            if base in self.fixed:
                raise ConfigurationError(
                    f"{base} is fixed and has no {what}; leave one of the two out.", value=name
                )
            if base in self.tied:
                raise ConfigurationError(
                    f"{base} is tied to {self.tied[base]} and has no {what} of its own; give that "
                    f"of {self.tied[base]}.",
                    value=name,
                )

    def n_unknowns(self, model: Model) -> int:
        """How many parameters of the model are left to fit."""
        return len(model.names) - len(self.fixed) - len(self.tied)

    def unknowns(
        self, model: Model
    ) -> tuple[tuple[Parameter, ...], KernelParameters, tuple[Reported, ...]]:
        """The unknowns, how they fill the kernel's arguments, and what a result states.

        Tied parameters share one unknown within the bounds of all of them. Reflectances whose sum
        is limited share out what those that are fixed leave.
        """
        free = [q for q in model.parameters if q.name not in self.fixed and q.name not in self.tied]
        unknowns = [self._joined(model, q) for q in free]
        index = {q.name: j for j, q in enumerate(free)}
        source, values, reported = [], [], []
        for q in model.parameters:
            end = self.tied.get(q.name, q.name)
            fixed = self.fixed.get(end)
            source.append(-1 if fixed is not None else index[end])
            values.append(0.0 if fixed is None else fixed)
            reported.append(
                Reported(q, None if fixed is not None else index[end], fixed, self.tied.get(q.name))
            )
        kernel = KernelParameters(np.array(source, np.int64), np.array(values))
        return self._within_sum(model, unknowns, kernel), kernel, tuple(reported)

    def _joined(self, model: Model, q: Parameter) -> Parameter:
        """The unknown for a parameter and those that are tied to it."""
        group = [q, *(model.parameter(name) for name, end in self.tied.items() if end == q.name)]
        return replace(
            q,
            lower=max(one.lower for one in group),
            upper=min(one.upper for one in group),
            linear=all(one.linear for one in group),
        )

    def _within_sum(
        self, model: Model, unknowns: list[Parameter], kernel: KernelParameters
    ) -> tuple[Parameter, ...]:
        """A single unknown in a limited sum is limited by its bound."""
        c = sum_limit(model, model.parameters)
        shares = kernel.reduced(c[None])[0] if len(unknowns) else np.zeros(0)
        left = 1 - float(c @ kernel.values)
        if np.count_nonzero(shares) == 1 and c.any():
            j = int(np.flatnonzero(shares)[0])
            upper = min(unknowns[j].upper, left / float(shares[j]))
            unknowns[j] = replace(unknowns[j], upper=upper)
        return tuple(unknowns)


def _end(model: Model, name: str, ties: Mapping[str, str]) -> str:
    """The parameter at the end of a chain of ties."""
    chain = [name]
    while chain[-1] in ties:
        chain.append(ties[chain[-1]])
        if chain[-1] in chain[:-1]:
            raise ConfigurationError(
                f"the ties {' -> '.join(chain)} form a circle: none of them would be an unknown; "
                "leave one of the ties out.",
                value=chain,
            )
    first, last = model.parameter(name), model.parameter(chain[-1])
    if first.unit != last.unit:
        units = [q.file_unit or "a number" for q in (first, last)]
        raise ConfigurationError(
            f"{first.name} cannot be tied to {last.name}: one is {units[0]}, the other is "
            f"{units[1]}; tie parameters of one unit.",
            value=(first.name, last.name),
        )
    if max(first.lower, last.lower) >= min(first.upper, last.upper):
        raise ConfigurationError(
            f"{first.name} cannot be tied to {last.name}: no value lies within the bounds of both.",
            value=(first.name, last.name),
        )
    return chain[-1]


def _check_sum(model: Model, constraints: Constraints) -> None:
    """Refuse fixed reflectances that leave nothing for the others."""
    c = sum_limit(model, model.parameters)
    values = {
        q.name: constraints.fixed.get(constraints.tied.get(q.name, q.name))
        for q, share in zip(model.parameters, c, strict=True)
        if share
    }
    total = sum(value for value in values.values() if value is not None)
    if total > 1 or (total == 1 and None in values.values()):
        names = " + ".join(name for name, value in values.items() if value is not None)
        raise ConfigurationError(
            f"{names} is fixed to {total:.6g}, and {' + '.join(values)} is at most 1; fix smaller "
            "values.",
            value=total,
        )
