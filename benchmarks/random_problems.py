"""Random problems, sparse and unfriendly plans included, against a multistart of scipy.

Run from the root of the checkout, in its environment:

    python -m benchmarks.random_problems --problems 2000

Every model is fitted to random materials, seen by a random plan with random noise. scipy's
least_squares then starts at the truth and at random points on the same residuals. A line a model
counts

- fits that are called converged although scipy went deeper (missed),
- results that hold a number that is not finite,
- intervals without their value inside,
- fits that raised an error that is not gonio's.

The exit code is 1 if there is any.
"""

from __future__ import annotations

import argparse
import math
import sys
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import gonio
from gonio import models
from gonio.errors import GonioError
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.result import FitResult
from gonio.geometry import Directions, FloatArray
from gonio.models import Model
from gonio.samples import BRDFSamples

STARTS = 16  # of scipy, the truth among them
MISSED = 0.1  # of the noise squared: a deeper minimum by less changes nothing
RELATIVE = 1e-6  # of chi-squared: what scipy's tolerance and rounding may differ
PLANS = ("grid", "plane", "one incidence", "random", "few", "near the mirror direction")
COUNTED = ("missed", "not finite", "outside", "raised")


def truth_of(model: Model, rng: np.random.Generator) -> dict[str, float]:
    """Parameters drawn over the ranges of the starting values; amplitudes may be almost nothing."""
    values = {}
    for q in model.parameters:
        low, high = q.start or (q.lower, q.upper)
        low, high = max(low, q.lower), min(high, q.upper)
        if q.linear:
            values[q.name] = float(rng.choice([rng.uniform(0.05, 0.45), 10 ** rng.uniform(-4, -1)]))
        elif q.scale == "log":
            values[q.name] = float(np.exp(rng.uniform(*np.log([low, high]))))
        else:
            values[q.name] = float(rng.uniform(low, high))
    return values


def plan(kind: str, least: int, rng: np.random.Generator) -> Directions:
    """Directions of one plan, at least so many."""
    if kind in ("grid", "plane", "one incidence"):
        n_i = 1 if kind == "one incidence" else int(rng.integers(2, 6))
        theta_i = np.sort(rng.uniform(0, 75, n_i))
        theta_r = np.arange(0, 80, rng.choice([5.0, 10.0]))
        phi_r = np.array([0.0, 180.0]) if kind == "plane" else np.arange(0, 360, 30.0)
        mesh = np.meshgrid(theta_i, theta_r, phi_r, indexing="ij")
        i, r, phi = (np.radians(each.ravel()) for each in mesh)
        return Directions(i, np.zeros(len(i)), r, phi)
    n = least + int(rng.integers(2, 12)) if kind == "few" else int(rng.integers(40, 400))
    theta = np.radians(rng.uniform(0, 80, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    if kind == "near the mirror direction":
        theta[1] = np.clip(np.abs(theta[0] + rng.normal(0, 0.2, n)), 0, 1.4)
        phi[1] = phi[0] + np.pi + rng.normal(0, 0.3, n)
    return Directions(theta[0], phi[0], theta[1], phi[1])


def problem(name: str, number: int, seed: int) -> tuple[BRDFSamples, dict[str, float], str]:
    """Samples, the truth and the plan's name."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
    model = models.get(name)
    truth = truth_of(model, rng)
    kind = PLANS[number % len(PLANS)]
    where = plan(kind, len(model.parameters), rng)
    f = model(where, **truth)
    noise = 10 ** rng.uniform(-3, -0.5)
    u = noise * f + noise * rng.choice([1e-3, 0.1]) * f.mean() + 1e-9
    value = f + u * rng.standard_normal(len(f))
    return BRDFSamples(where, value, u_independent=u if rng.random() < 0.7 else None), truth, kind


def multistart(held: Problem, truth: FloatArray, rng: np.random.Generator) -> float:
    """The least chi-squared at which scipy ends, from the truth and from random starts."""
    lower = np.array([q.lower for q in held.parameters])
    upper = np.array([q.upper for q in held.parameters])
    log = np.array([q.scale == "log" for q in held.parameters])
    root = np.sqrt(held.inverse_variance)
    c = held.sum_limit

    def inner(p: FloatArray) -> FloatArray:
        return np.where(log, np.log(np.where(log, p, 1.0)), p)

    def outer(x: FloatArray) -> FloatArray:
        return np.clip(np.where(log, np.exp(np.where(log, x, 0.0)), x), lower, upper)

    def residuals(x: FloatArray) -> FloatArray:
        return root * (held.samples.value - held.values(outer(x)))

    def jacobian(x: FloatArray) -> FloatArray:
        p = outer(x)
        return -root[:, None] * held.jacobian(p)[1] * np.where(log, p, 1.0)

    bounds = inner(lower), inner(upper)
    inside = bounds[1] - bounds[0]
    starts = [inner(truth), *(bounds[0] + inside * rng.random(len(lower)) for _ in range(STARTS))]
    least = math.inf
    for start in starts[:STARTS]:
        start = np.clip(start, bounds[0] + 1e-6 * inside, bounds[1] - 1e-6 * inside)
        try:
            end = least_squares(residuals, start, jacobian, bounds, x_scale="jac", max_nfev=200)
        except (ValueError, np.linalg.LinAlgError):
            continue
        if float(c @ outer(end.x)) <= 1:
            least = min(least, 2 * float(end.cost))
    return least


def faults(result: FitResult, truth: dict[str, float], rng: np.random.Generator) -> list[str]:
    """What is wrong with a result, among `COUNTED`, each with its evidence."""
    found = []
    try:
        result.to_json()
    except ValueError as error:
        found.append(f"not finite: {error}")
    for name, e in result.parameters.items():
        for interval in (e.interval_68, e.interval_95):
            if interval is not None and not interval[0] <= e.value <= interval[1]:
                found.append(f"outside: {name} = {e.value:.6g} in {interval}")
    held = result.memory.problem
    set_to_bound = any("was set to its bound" in text for text in result.warnings)
    if result.status == "converged" and not set_to_bound:
        own = held.chi2(result.memory.p)
        other = multistart(held, held.vector(truth), rng)
        noise = max(result.noise_scale, 1e-300)
        size = float(np.sum(held.samples.value**2 * held.inverse_variance))
        if own - other > MISSED * noise**2 + RELATIVE * own + 1e-20 * size:
            gain = (own - other) / noise**2
            found.append(f"missed: chi2 smaller by {gain:.3g} of the noise squared")
    return found


def one(name: str, number: int, seed: int) -> tuple[str, list[str]]:
    """Status and faults of one problem."""
    samples, truth, kind = problem(name, number, seed)
    rng = np.random.default_rng([seed, number])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = gonio.fit(samples, name, threads=1)
            return result.status, [f"{text} ({kind})" for text in faults(result, truth, rng)]
    except GonioError as error:
        return "refused", [] if str(error) else [f"raised: no words ({kind})"]
    except Exception as error:
        return "error", [f"raised: {type(error).__name__}: {error} ({kind})"]


def run(names: list[str], total: int, seed: int) -> Iterator[tuple[str, int, str, list[str]]]:
    """Every problem in turn: model, number, status, faults."""
    for k in range(total):
        name, number = names[k % len(names)], k // len(names)
        yield name, number, *one(name, number, seed)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--problems", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model", action="append", metavar="NAME", help="may be repeated")
    arguments = parser.parse_args()
    names = arguments.model or [n for n in models.names() if not models.get(n).costly]
    counts: dict[str, Counter[str]] = {name: Counter() for name in names}
    for name, number, status, found in run(names, arguments.problems, arguments.seed):
        counts[name]["problems"] += 1
        counts[name][status] += 1
        for text in found:
            counts[name][text.partition(":")[0]] += 1
            print(f"{name} {number}: {text}", file=sys.stderr, flush=True)
    columns: list[Any] = ["problems", "converged", "not_converged", "refused", *COUNTED]
    print("| model | " + " | ".join(columns) + " |")
    print("|---|" + "---:|" * len(columns))
    for name, count in counts.items():
        print(f"| {name} | " + " | ".join(str(count[c]) for c in columns) + " |")
    return int(any(count[kind] for count in counts.values() for kind in COUNTED))


if __name__ == "__main__":
    sys.exit(main())
