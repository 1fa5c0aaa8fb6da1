"""Lines of text about a fit: its weights, selections, posterior and shared errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gonio.fitting.result.estimates import NuisanceEstimate, PosteriorSummary

WEIGHTS = {
    "sd": "1/uncertainty",
    "none": "equal",
    "cos": "cos theta_r",
    "coscos": "cos theta_i cos theta_r",
    "relative": "1/fitted value",
}


METHODS = {"gauss_newton": "Gauss-Newton"}


def engine_text(engine: str, polish: str) -> str:
    """What searched for the minimum and what polished it.

    Examples
    --------
    >>> engine_text("lbfgs", "gauss_newton")
    'nlopt lbfgs, then Gauss-Newton'
    >>> engine_text("gauss_newton", "gauss_newton")
    'Gauss-Newton'
    """
    last = METHODS.get(polish, polish)
    return last if engine == polish else f"nlopt {engine}, then {last}"


def cuts_line(cuts: Mapping[str, Any]) -> str:
    """What was left out, to stand behind the number of samples; empty where nothing was."""
    parts = [
        f"{name} <= {limit:g} deg"
        for name, limit in (
            ("theta_i", cuts.get("max_theta_i_deg")),
            ("theta_r", cuts.get("max_theta_r_deg")),
        )
        if limit is not None
    ]
    parts += [f"{key} = {value}" for key, value in (cuts.get("select") or {}).items()]
    return f" with {', '.join(parts)}" if parts else ""


def posterior_lines(p: PosteriorSummary) -> list[str]:
    """Whether the posterior converged, how it was sampled, and priors that are not flat."""
    lines = [
        f"posterior: {'converged' if p.converged else 'NOT converged'}, {p.ess:.0f} effective "
        f"draws, R-hat {p.r_hat:.4f}, autocorrelation {p.tau:.1f} steps; intervals are its "
        "quantiles"
    ]
    parts = []
    if p.sampler is not None:
        parts.append(f"{p.sampler} sampler" + (f" ({p.note})" if p.note else ""))
    if p.ess_tail is not None:
        parts.append(f"{p.ess_tail:.0f} effective draws in the tails")
    if p.k_hat is not None:
        parts.append(f"k-hat {p.k_hat:.2f}")
    lines += ["  " + ", ".join(parts)] if parts else []
    lines += [f"  {p.allowance}"] if p.allowance else []
    believed = [f"{name} {text}" for name, text in p.priors.items() if text != "flat"]
    others = "; the others flat" if len(believed) < len(p.priors) else ""
    return lines + ([f"  priors: {', '.join(believed)}{others}"] if believed else [])


def nuisance_lines(profiled: Sequence[NuisanceEstimate]) -> list[str]:
    """A line for each shared error, in units of its stated standard uncertainty.

    Examples
    --------
    >>> from gonio.fitting.result import NuisanceEstimate
    >>> lamp = [NuisanceEstimate("lamp", k, z, 0.5) for k, z in enumerate((0.3, -0.4))]
    >>> for line in nuisance_lines([NuisanceEstimate("standard", None, 0.02, 0.999), *lamp]):
    ...     print(line)
    profiled shared errors, in units of their stated standard uncertainty (prior 0 ± 1):
      standard       +0.02 ± 1.00
      lamp           2 draws of rms 0.35, the largest -0.40 ± 0.50
    """
    names = list(dict.fromkeys(e.name for e in profiled))
    width = max(14, *map(len, names))
    lines = ["profiled shared errors, in units of their stated standard uncertainty (prior 0 ± 1):"]
    for name in names:
        draws = [e for e in profiled if e.name == name]
        largest = max(draws, key=lambda e: abs(e.estimate))
        text = f"{largest.estimate:+.2f} ± {largest.stderr:.2f}"
        if len(draws) > 1:
            rms = (sum(e.estimate**2 for e in draws) / len(draws)) ** 0.5
            text = f"{len(draws)} draws of rms {rms:.2f}, the largest {text}"
        lines.append(f"  {name:<{width}} {text}")
    return lines
