"""One page: frames, slices, posterior and the recovered parameters."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor, log10, radians
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure, SubFigure

import gonio.models as models
from gonio.errors import DataError
from gonio.fitting.result import Estimate, FitResult
from gonio.fitting.result.verdict import WORDS
from gonio.plotting.frames import default_incidences, frames
from gonio.plotting.lobe import in_plane, slices
from gonio.plotting.posterior import corner
from gonio.plotting.style import GREY, VERMILLION, nothing_to_draw, style, symbol, unit_text
from gonio.samples import BRDFSamples
from gonio.session import Session

WIDTH = 10.0  # inches
_HEIGHTS = {"heading": 0.55, "frames": 3.2, "slices": 3.75}  # inches


def summary(
    fit: FitResult | None,
    samples: BRDFSamples | None,
    session: Session | None = None,
    draws: Any = None,
    *,
    truth: Mapping[str, float] | None = None,
) -> Figure:
    """Draw a measurement and its fit on one page.

    Parameters
    ----------
    fit : FitResult or None
    samples : BRDFSamples or None
        What the fit was made to.
    session : Session, optional
        The raw frames.
    draws : path or xarray.Dataset, optional
        The posterior's draws, netCDF, or as `read_draws` gives them.
    truth : mapping of str to float, optional
        True values of the parameters, angles in radians. Where not given, those that the fit
        records for its source.

    Returns
    -------
    Figure
        10 inches wide; panels that have no content are left out.

    Raises
    ------
    DataError
        If there is nothing to draw, or a file that was given cannot be read.
    """
    if fit is not None and truth is None:
        truth = _recorded_truth(fit)
    chain = read_draws(draws) if isinstance(draws, str | Path) else draws
    if samples is not None and not in_plane(samples):
        samples = None
    if session is None and samples is None and fit is None:
        raise nothing_to_draw("neither frames nor samples near a plane of incidence are there")
    rows = _rows(fit, samples, session, chain)
    with style():
        figure = Figure(figsize=(WIDTH, sum(rows.values())), layout="constrained")
        parts = figure.subfigures(len(rows), 1, height_ratios=list(rows.values()), squeeze=False)
        panel: dict[str, Any] = dict(zip(rows, parts[:, 0], strict=True))
        _heading(panel["heading"], fit, samples, session)
        if session is not None:
            n = len(default_incidences(session.metadata))
            frames(session, axes=list(panel["frames"].subplots(1, n, squeeze=False)[0]))
        _lower(panel.get("slices"), fit, samples, chain, truth)
    return figure


def _recorded_truth(fit: FitResult) -> dict[str, float]:
    """True values that the fit's source states in degrees, angles in radians."""
    recorded = fit.source.get("truth") or {}
    units = {name: estimate.unit for name, estimate in fit.parameters.items()}
    return {
        name: radians(value) if units.get(name) == "rad" else value
        for name, value in recorded.items()
    }


def read_draws(path: str | Path) -> Any:
    """The draws of a posterior as an xarray.Dataset, angles in degrees as the file has them.

    Raises
    ------
    DataError
        If the file is missing or holds no group "posterior".
    """
    import xarray as xr

    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: no such file; it would hold the posterior's draws.", value=path)
    try:
        with xr.open_dataset(path, group="posterior", engine="h5netcdf") as dataset:
            return dataset.load()
    except (OSError, KeyError, ValueError) as error:
        raise DataError(
            f"{path}: not readable as the draws of a posterior ({type(error).__name__}); "
            "make it again with 'gonio fit --posterior'.",
            value=path,
        ) from error


def _rows(
    fit: FitResult | None, samples: BRDFSamples | None, session: Session | None, chain: Any
) -> dict[str, float]:
    """The page's rows and their heights in inches, from the top."""
    rows = {"heading": _HEIGHTS["heading"]}
    if session is not None:
        rows["frames"] = _HEIGHTS["frames"]
    if samples is not None or chain is not None or fit is not None:
        rows["slices"] = _HEIGHTS["slices"]
    return rows


def _lower(
    part: SubFigure | None,
    fit: FitResult | None,
    samples: BRDFSamples | None,
    chain: Any,
    truth: Mapping[str, float] | None,
) -> None:
    """Slices above the table at the left, the posterior at the right."""
    if part is None:
        return
    left = part
    if chain is not None and (samples is not None or fit is not None):
        left, right = part.subfigures(1, 2, width_ratios=[1.15, 1], squeeze=False)[0]
        corner(chain, truth, right)
    elif chain is not None:
        corner(chain, truth, part)
        return
    if samples is not None and fit is not None:
        height = 0.2 + 0.2 * (1 + len(fit.parameters))
        ratios = [_HEIGHTS["slices"] - height, height]
        left, below = left.subfigures(2, 1, height_ratios=ratios, squeeze=False)[:, 0]
        _table(below, fit, truth)
    elif fit is not None:
        _table(left, fit, truth)
        return
    if samples is not None:
        slices(samples, fit, left.subplots())


def _heading(
    part: SubFigure,
    fit: FitResult | None,
    samples: BRDFSamples | None,
    session: Session | None,
) -> None:
    """Material, instrument and model; below, in grey, the quality of the fit."""
    title, second = _heading_text(fit, samples, session)
    part.text(0.012, 0.95, title, ha="left", va="top", fontsize=12, fontweight="bold")
    part.text(0.012, 0.42, second, ha="left", va="top", fontsize=8, color=GREY)
    if fit is not None and not fit.converged:
        stage = "the fit" if fit.status != "converged" else "the posterior"
        part.text(
            0.988, 0.95, f"{stage} has not converged", ha="right", va="top", fontsize=10,
            color=VERMILLION, fontweight="bold",
        )  # fmt: skip


def _heading_text(
    fit: FitResult | None, samples: BRDFSamples | None, session: Session | None
) -> tuple[str, str]:
    source: dict[str, Any] = dict(fit.source if fit else samples.metadata if samples else {})
    if session is not None:
        source = {
            "sample": session.metadata.sample,
            "instrument": session.metadata.instrument,
            **source,
        }
    sample = source.get("sample")
    name = str(sample).replace("_", " ") if sample else str(source.get("path") or "BRDF samples")
    title = name + (f" on {source['instrument']}" if source.get("instrument") else "")
    facts = []
    if fit is not None:
        title += f": {models.of_fit(fit).title}"
        facts += [f"{_grouped(fit.n_samples)} samples"]
        if fit.verdict is not None:
            facts.append(f"verdict: {WORDS[fit.verdict.kind]}")
        if fit.posterior is not None:
            facts.append(f"posterior: {_grouped(fit.posterior.ess)} effective draws")
            facts.append(f"R-hat {fit.posterior.r_hat:.3f}")
        facts.append(f"seed {fit.seed}")
    elif samples is not None:
        facts.append(f"{_grouped(len(samples))} samples")
    if samples is not None and samples.wavelength_nm is not None:
        facts.append(f"{samples.wavelength_nm[0]:g} nm")
    if session is not None:
        plan = session.metadata.plan
        images = len(plan.theta_i_deg) * len(plan.rotations_deg)
        facts.insert(0, f"{images} images of {len(plan.exposures_s)} exposures")
    return title, "  ·  ".join(facts)


def _table(part: SubFigure, fit: FitResult, truth: Mapping[str, float] | None) -> None:
    """Recovered values and their standard uncertainties u beside the true values where known."""
    model = models.of_fit(fit)
    ax = part.subplots()
    ax.set_axis_off()
    head = ["", "meaning", "recovered ± u"]
    if truth:
        head += ["true", "difference / u"]
    body = []
    for name, fitted in fit.parameters.items():
        estimate = fitted.in_file_units()
        q = model.parameter(name)
        line = [symbol(q), q.meaning, recovered(estimate)]
        if truth:
            true = truth.get(name)
            line += _true_columns(estimate, None if true is None else q.to_file(true))
        body.append(line)
    widths = _column_widths([head, *body])
    table = ax.table(
        [head, *body], loc="upper center", cellLoc="left", edges="open", colWidths=widths
    )
    table.auto_set_font_size(False)
    table.set_fontsize(7.5)
    for (row, _), cell in table.get_celld().items():
        cell.set_height(1 / (1.4 + len(body)))
        cell.PAD = 0.02
        cell.visible_edges = "B" if row == 0 else "open"
        cell.set_linewidth(0.6)
        if row == 0:
            cell.set_text_props(color=GREY)


def _column_widths(rows: list[list[str]]) -> list[float]:
    """Shares of the width by the longest text of each column; a symbol counts as 3 letters."""
    letters = [
        max(3 if text.startswith("$") else len(text) for text in column) + 2
        for column in zip(*rows, strict=True)
    ]
    return [n / sum(letters) for n in letters]


def recovered(estimate: Estimate) -> str:
    """Value and standard uncertainty with two digits of the uncertainty.

    Examples
    --------
    >>> recovered(Estimate(0.20925397, 0.0023293, "", None, None, None))
    '0.2093 ± 0.0023'
    >>> recovered(Estimate(0.0, None, "", "lower", None, None))
    '0 (at its lower bound)'
    >>> recovered(Estimate(0.0094, 0.0001, "", None, None, None, established=False))
    '0.00940 ± 0.00010 (not established by these data)'
    """
    if estimate.stderr is None:
        why = f"at its {estimate.at_bound} bound" if estimate.at_bound else "not determined"
        return f"{estimate.value:.4g}{_unit(estimate)} ({why})"
    digits = _digits(estimate.stderr)
    weak = " (not established by these data)" if estimate.established is False else ""
    return f"{estimate.value:.{digits}f} ± {estimate.stderr:.{digits}f}{_unit(estimate)}{weak}"


def _unit(estimate: Estimate) -> str:
    text = unit_text(estimate.unit)
    return f" {text}" if text else ""


def _digits(u: float) -> int:
    """Decimals that show two significant digits of u."""
    return max(0, 1 - floor(log10(u))) if u > 0 else 6


def _true_columns(estimate: Estimate, true: float | None) -> list[str]:
    if true is None:
        return ["", ""]
    text = f"{true:.6g}{_unit(estimate)}"
    if not estimate.stderr:
        return [text, ""]
    ratio = f"{(estimate.value - true) / estimate.stderr:+z.1f}"
    return [text, "0.0" if ratio == "+0.0" else ratio.replace("-", "−")]


def _grouped(number: float) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{number:,.0f}".replace(",", "\u2009")
