"""An error that many samples have in common, and what it does to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.terms_of_0_1 import properties

Evaluation = Literal["A", "B"]
BelongsTo = Literal["rig", "session"]


@dataclass(frozen=True)
class SharedTerm:
    """An error that many samples share: one unknown number with unit variance for each group.

    It moves viewing directions (`shift`, `blur`), turns the sample (`turn`), or changes values, by
    `relative` times the value times `profile`, plus `offset`.

    Parameters
    ----------
    name, meaning : str
        Short name and one sentence.
    relative : float
        Change of a sample's value for one standard deviation, as a fraction of the value.
    group : ndarray of int64, shape (N,), optional
        Samples with the same number share one draw; all samples share it where None.
    shift : ndarray, shape (N, 3), optional
        Change of the viewing direction for one standard deviation, tangent vectors in radians;
        used in place of `relative` where given.
    profile : ndarray, shape (N,), optional
        Factor on `relative`, sample by sample; 1 where not given.
    blur : float
        Standard deviation on each axis, radians, by which viewing directions may be blurred; used
        in place of `relative` where positive.
    offset : ndarray, shape (N,), optional
        Change of the sample's value for one standard deviation whatever the value is, sr^-1; it
        adds to what `relative` does.
    turn : float
        Standard deviation of a turn of the sample about its normal, counter-clockwise, radians:
        it takes both directions along; used in place of `relative` where positive.
    typical : bool
        True where the term stands for errors of many shapes by a typical one, as for an uneven
        dome: it says how far parameters may be off, and is no unknown that data could tell.
    effect : str, optional
        The source of error that the term belongs to, a key of `gonio.calibration.effects`. This
        and the following are None where they are not known, as for terms of one's own.
    evaluation : {"A", "B"}, optional
        A: from a fit to calibration frames; B: stated by certificate or operator.
    averages : bool, optional
        Whether more takes of standard and background make it smaller.
    constant : bool, optional
        Whether it is the same in every session that is simulated, whatever the seed.
    belongs_to : {"rig", "session"}, optional
        Whether two sessions on one rig have the same draw of it, or each has its own.
    """

    name: str
    meaning: str
    relative: float = 0.0
    group: NDArray[np.int64] | None = None
    shift: FloatArray | None = None
    blur: float = 0.0
    profile: FloatArray | None = None
    offset: FloatArray | None = None
    turn: float = 0.0
    typical: bool = False
    effect: str | None = None
    evaluation: Evaluation | None = None
    averages: bool | None = None
    constant: bool | None = None
    belongs_to: BelongsTo | None = None

    def select(self, keep: NDArray[np.int64]) -> SharedTerm:
        """The term for these samples."""
        return replace(
            self,
            group=None if self.group is None else self.group[keep],
            shift=None if self.shift is None else self.shift[keep],
            profile=None if self.profile is None else self.profile[keep],
            offset=None if self.offset is None else self.offset[keep],
        )

    @property
    def moves_directions(self) -> bool:
        """Whether the error is one of directions and not of the value."""
        return self.shift is not None or self.blur > 0 or self.turn > 0

    @property
    def of_rig(self) -> bool:
        """Whether two sessions on one rig have the same draw: `belongs_to`, or what it suggests.

        Where nobody states it, an error of directions or one number for all samples is the rig's.
        """
        if self.belongs_to is not None:
            return self.belongs_to == "rig"
        return self.moves_directions or self.group is None

    def change(self, value: FloatArray) -> FloatArray:
        """Change of values (N,) for one standard deviation; 0 where it `moves_directions`."""
        change = (0.0 if self.moves_directions else self.relative) * value
        if self.profile is not None:
            change = change * self.profile
        return change if self.offset is None else change + self.offset

    @property
    def n_draws(self) -> int:
        """How many unknown numbers the term has: one for each group, one without groups."""
        return max(len(self.labels), 1)

    @property
    def labels(self) -> list[int | None]:
        """Group of each draw in the order of `draw`, as `group` has it; [None] without groups.

        Examples
        --------
        >>> SharedTerm("lamp", "", 0.01, group=np.array([7, 3, 7])).labels
        [3, 7]
        >>> SharedTerm("standard", "", 0.01).labels
        [None]
        """
        return [None] if self.group is None else np.unique(self.group).tolist()

    def draw(self, n: int) -> NDArray[np.int64]:
        """Number of the draw that each sample has, from 0 on without gaps.

        Parameters
        ----------
        n : int
            Number of samples, which a term without groups does not hold.

        Returns
        -------
        ndarray of int64, shape (n,)

        Examples
        --------
        >>> SharedTerm("lamp", "", 0.01, group=np.array([7, 3, 7])).draw(3)
        array([1, 0, 1])
        """
        if self.group is None:
            return np.zeros(n, np.int64)
        return np.unique(self.group, return_inverse=True)[1].astype(np.int64)

    def columns(self, change: FloatArray) -> Any:
        """Change of every sample for one standard deviation of every draw.

        Parameters
        ----------
        change : ndarray, shape (N,)
            Change of the samples for one standard deviation of the draw that each has.

        Returns
        -------
        scipy.sparse.csr_array, shape (N, draws)

        Examples
        --------
        >>> lamp = SharedTerm("lamp", "", 0.01, group=np.array([7, 3, 7]))
        >>> print(lamp.columns(np.array([1.0, 2.0, 3.0])).toarray())
        [[0. 1.]
         [2. 0.]
         [0. 3.]]
        """
        from scipy.sparse import csr_array

        n = len(change)
        places = (np.arange(n), self.draw(n))
        return csr_array((change, places), shape=(n, self.n_draws))

    def record(self) -> dict[str, Any]:
        """Words, numbers and properties for JSON; the arrays are left out."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in COLUMNS}

    @classmethod
    def from_record(cls, record: Mapping[str, Any], columns: Mapping[str, Any]) -> SharedTerm:
        """The term that `record` describes.

        Parameters
        ----------
        record : mapping
            As `record` gave it, or as files of version 0.1 have it, without `effect`: what the
            term is then follows from its name (`gonio.terms_of_0_1`).
        columns : mapping
            The array, or None, for each name of `COLUMNS`.

        Raises
        ------
        KeyError
            If it lacks name, meaning or size.
        """
        own = {f.name for f in fields(cls) if f.name not in COLUMNS}
        known = {} if "effect" in record else properties(record["name"])
        stated = {name: value for name, value in record.items() if name in own}
        sizes = {name: float(record[name]) for name in ("relative", "blur")}
        return cls(**{**known, **stated, **sizes, **columns})


# Fields of a term that have a value for every sample, and their units.
COLUMNS = {"group": "1", "profile": "1", "offset": "sr-1", "shift": "rad"}
