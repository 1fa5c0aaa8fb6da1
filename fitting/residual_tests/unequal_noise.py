"""Whether noise of unknown size depends on the value that is measured."""

from __future__ import annotations

import numpy as np

from gonio.geometry import FloatArray

RANK = 1e-12  # of the largest eigenvalue, below which one is rounding
ROUNDING = 1e-12  # range of the level, relative, that is none


def unequal_noise(z: FloatArray, level: FloatArray) -> float:
    """Chance of squared residuals that follow the model's value so clearly, were the noise alike.

    Parameters
    ----------
    z : ndarray, shape (N,)
        Residuals times the root of the weights.
    level : ndarray, shape (N,)
        Model values times the root of the weights.

    Returns
    -------
    float
        p-value of Koenker's studentised form of Breusch and Pagan's test with f and f^2: it does
        not need the noise to be normal.

    References
    ----------
    Koenker 1981, J. Econometrics 17, 107.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> level = rng.uniform(0, 1, 500)
    >>> unequal_noise(rng.standard_normal(500), level) > 0.01
    True
    >>> unequal_noise(level * rng.standard_normal(500), level) < 1e-6
    True
    """
    from scipy.special import chdtrc

    # Coordinates about the middle: their squares are far from following the level itself.
    reach = float(np.ptp(level)) if len(level) else 0.0
    x = np.zeros(len(level))
    if reach > ROUNDING * float(np.max(np.abs(level), initial=0.0)):
        x = (level - float(np.mean(level))) / reach
    design = np.stack([np.ones(len(x)), x, x**2])
    size = max(float(np.max(np.abs(z), initial=0.0)), 1e-300)
    square = (z / size) ** 2
    square = square - np.mean(square)
    total = float(square @ square)
    if total == 0:
        return 1.0
    products, on_square = design @ design.T, design @ square
    values, vectors = np.linalg.eigh(products)
    good = values > RANK * values[-1]
    explained = float(np.sum((vectors[:, good].T @ on_square) ** 2 / values[good]))
    return float(chdtrc(max(int(np.count_nonzero(good)) - 1, 1), len(z) * explained / total))
