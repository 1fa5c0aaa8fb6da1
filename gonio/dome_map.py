"""The map of a dome: displacements of directions by its slope errors, with their uncertainty.

Samples of ordinary sessions hold it (`gonio.fitting.dome_field` makes it), and the reduction of
other sessions on the rig applies it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError
from gonio.files import atomic_path
from gonio.geometry import FloatArray
from gonio.tangent_field import FieldPrior, Nodes, tangents

SCHEMA = "gonio.dome/1"
MOST = 50_000_000  # numbers of an array
LEARNT = 0.9  # posterior over prior sd below which a direction counts as known
UNKNOWN = 0.999  # posterior over prior sd from which on nothing is known


@dataclass(frozen=True)
class DomeMap:
    """Displacements that the dome of one rig adds to the mapped directions, in the laboratory.

    Parameters
    ----------
    rig : str
        Identity of the rig.
    instrument, shape, mapping : str
        Instrument, shape of the dome, and how pixels became directions: the map holds what that
        mapping leaves out as well.
    R, D : float
        mm.
    nodes : Nodes
        With the prior, its size refined by the marginal likelihood.
    stated : FieldPrior
        What was stated before.
    mean : ndarray, shape (2, K)
        Most likely displacement at the nodes along the two tangents, radians.
    gain : ndarray, shape (2 K, m)
        The posterior covariance is that of the prior less gain gain^T, rad.
    sessions : tuple of str
        SHA-256 of the sessions that the map was made of.
    findings : mapping
        Numbers about the solution, JSON-serialisable.
    """

    rig: str
    instrument: str
    shape: str
    mapping: str
    R: float
    D: float
    nodes: Nodes
    stated: FieldPrior
    mean: FloatArray
    gain: FloatArray
    sessions: tuple[str, ...]
    findings: Mapping[str, Any] = field(default_factory=dict)

    def displacement(self, directions: FloatArray) -> FloatArray:
        """Displacement (N, 3), tangent vectors in radians, at unit vectors (N, 3)."""
        near = self.nodes.interpolation(directions)
        along_x, along_y = tangents(directions)
        x, y = (near(component)[:, None] for component in self.mean)
        return np.asarray(x * along_x + y * along_y)

    def corrected(self, directions: FloatArray) -> FloatArray:
        """Unit vectors (..., 3) where the dome's slope errors turn these mapped directions to."""
        flat = directions.reshape(-1, 3)
        there = np.array(flat)
        # Pixels outside the image circle have no direction.
        seen = np.flatnonzero(np.all(np.isfinite(flat), axis=1) & (flat[:, 2] > 0))
        moved = flat[seen] + self.displacement(flat[seen])
        there[seen] = moved / np.linalg.norm(moved, axis=1, keepdims=True)
        return there.reshape(directions.shape)

    def sd(self, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Standard deviations (N, 2) of both components with the map, and (N,) before, radians."""
        near = self.nodes.interpolation(directions)
        before = self.nodes.prior.sd(directions)
        k = len(self.nodes)
        lost = [np.sum(near(part) ** 2, axis=1) for part in (self.gain[:k], self.gain[k:])]
        variance = np.maximum(before[:, None] ** 2 - np.stack(lost, axis=1), 0.0)
        return np.sqrt(variance), before

    def remaining(
        self, directions: FloatArray, tangent: FloatArray, weight: Sequence[float]
    ) -> float:
        """What is left of the sd of sum_j weight_j tangent_j . displacement(direction_j).

        Parameters
        ----------
        directions, tangent : ndarray, shape (J, 3)
        weight : sequence of float

        Returns
        -------
        float
            Posterior over prior standard deviation, exactly 1 where nothing is known.
        """
        near = self.nodes.interpolation(directions)
        row = np.zeros((2, len(self.nodes)))
        for component, axis in enumerate(tangents(directions)):
            size = np.asarray(weight) * np.sum(axis * tangent, axis=1)
            np.add.at(row[component], near.index, size[:, None] * near.weight)
        before = float(np.sum((row @ self.nodes.root) ** 2))
        lost = float(np.sum((row.ravel() @ self.gain) ** 2))
        left = float(np.sqrt(max(1 - lost / max(before, 1e-300), 0.0)))
        return 1.0 if left > UNKNOWN else left

    @cached_property
    def known(self) -> FloatArray:
        """Posterior over prior standard deviation (K,) at the nodes, of the better component."""
        after, before = self.sd(self.nodes.directions)
        return np.asarray(np.min(after, axis=1) / before)

    def check(self, *, rig: str | None, shape: str, mapping: str, session: str) -> None:
        """Refuse a session that the map does not serve.

        Parameters
        ----------
        rig, shape, mapping : str
            Of the session and its reduction.
        session : str
            Its SHA-256.

        Raises
        ------
        ConfigurationError
        """
        if rig != self.rig or shape != self.shape:
            raise ConfigurationError(
                f"the map is that of the dome of {self.rig!r}, and the session was taken with "
                f"{rig or 'a rig without a name'!r}; make a map of its own dome with 'gonio "
                "calibrate dome'.",
                value=rig,
            )
        if mapping != self.mapping:
            raise ConfigurationError(
                f"the map belongs to directions by mapping {self.mapping!r}, not {mapping!r}; "
                f"reduce with --mapping {self.mapping}.",
                value=mapping,
            )
        if session in self.sessions:
            raise ConfigurationError(
                "the map was made of this session, whose noise would count twice; fit its samples "
                "with --self-calibrate instead.",
                value=session,
            )

    def save(self, path: str | Path) -> None:
        """Write the map as netCDF, whole or not at all.

        Raises
        ------
        ConfigurationError
            If the name does not end in .nc.
        DataError
            If the file cannot be written.
        """
        import xarray as xr

        path = Path(path)
        if path.suffix != ".nc":
            raise ConfigurationError(
                f"{path}: a map of a dome is written as netCDF; give a name that ends in .nc.",
                value=path,
            )
        k = len(self.nodes)
        dataset = xr.Dataset(
            {
                "direction": (("node", "xyz"), self.nodes.directions),
                "mean": (("component", "node"), self.mean, {"units": "rad"}),
                "gain": (("component", "node", "mode"), self.gain.reshape(2, k, -1)),
            },
            attrs={
                "schema": SCHEMA,
                **{name: getattr(self, name) for name in _TEXTS},
                "R_mm": self.R,
                "D_mm": self.D,
                "prior": _numbers(self.nodes.prior),
                "stated": _numbers(self.stated),
                "sessions": json.dumps(self.sessions),
                "findings": json.dumps(self.findings),
            },
        )
        with atomic_path(path) as temporary:
            dataset.to_netcdf(temporary, engine="h5netcdf")

    @classmethod
    def load(cls, path: str | Path) -> DomeMap:
        """Read a map that `save` wrote.

        Raises
        ------
        DataError
            If the file is missing, damaged or no map.
        """
        import xarray as xr

        path = Path(path)
        if not path.is_file():
            raise DataError(f"{path}: no such file; give a map of a dome (.nc).", value=path)
        try:
            _check(path)
            with xr.open_dataset(path, engine="h5netcdf") as dataset:
                return cls._of(dataset.load())
        except (OSError, KeyError, ValueError, TypeError, np.linalg.LinAlgError) as error:
            raise DataError(
                f"{path}: not a readable map of a dome ({type(error).__name__}: {error}); make it "
                "again with 'gonio calibrate dome'.",
                value=path,
            ) from error

    @classmethod
    def _of(cls, dataset: Any) -> DomeMap:
        attrs = dataset.attrs
        directions, mean, gain = (
            np.asarray(dataset[name].values, float) for name in ("direction", "mean", "gain")
        )
        k = len(directions)
        if directions.shape != (k, 3) or mean.shape != (2, k) or gain.shape[:2] != (2, k):
            raise ValueError(f"arrays of shapes {directions.shape}, {mean.shape}, {gain.shape}")
        if not all(np.all(np.isfinite(each)) for each in (directions, mean, gain)):
            raise ValueError("a number is not finite")
        prior, stated = (
            FieldPrior(*(float(x) for x in np.atleast_1d(attrs[n]))) for n in ("prior", "stated")
        )
        return cls(
            **{name: str(attrs[name]) for name in _TEXTS},
            R=float(attrs["R_mm"]),
            D=float(attrs["D_mm"]),
            nodes=Nodes(directions, prior),
            stated=stated,
            mean=mean,
            gain=gain.reshape(2 * k, -1),
            sessions=tuple(json.loads(attrs["sessions"])),
            findings=json.loads(attrs["findings"]),
        )


_TEXTS = ("rig", "instrument", "shape", "mapping")


def is_dome_map(path: str | Path) -> bool:
    """Whether a file is a map of a dome."""
    import xarray as xr

    path = Path(path)
    if path.suffix != ".nc" or not path.is_file():
        return False
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            return bool(dataset.attrs.get("schema") == SCHEMA)
    except (OSError, ValueError):
        return False


def _numbers(prior: FieldPrior) -> list[float]:
    return [prior.zenith, prior.rim, prior.correlation]


def _check(path: Path) -> None:
    """Refuse another schema, and sizes that no map has, before anything is allocated."""
    import h5py

    with h5py.File(path) as file:
        schema = file.attrs.get("schema")
        if schema != SCHEMA:
            raise DataError(
                f"{path}: the schema is {schema!r}, not {SCHEMA!r}; give a map that 'gonio "
                "calibrate dome' wrote.",
                value=path,
            )
        for name, data in file.items():
            if getattr(data, "size", 0) > MOST:
                raise DataError(
                    f"{path}: {data.size} numbers of {name!r} are more than a map of a dome may "
                    f"hold ({MOST}).",
                    value=path,
                )
