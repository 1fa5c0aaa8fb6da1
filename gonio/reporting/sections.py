"""Text and tables of a report, from the record of a fit and its data."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import gonio.models as models
from gonio.errors import GonioError
from gonio.fitting.result import Estimate, FitResult
from gonio.fitting.result.lines import engine_text
from gonio.plotting.style import unit_text
from gonio.plotting.summary import recovered
from gonio.reporting.budget import shares
from gonio.reporting.inputs import Inputs
from gonio.reporting.markup import UNKNOWN, Markup, items, section, table, tag, text
from gonio.reporting.residuals import Residuals
from gonio.reporting.statement import Statement
from gonio.reporting.tables import rounded
from gonio.session import Session

_NIL = 1e-6
_WEIGHTS = {
    "sd": "one over the standard uncertainty",
    "none": "equal",
    "cos": "cos θr",
    "coscos": "cos θi cos θr",
    "relative": "one over the fitted value",
}


def heading(inputs: Inputs, stated: Statement) -> Markup:
    """Title, status, what the operator states, and warnings."""
    fit = inputs.fit
    facts = [
        ("Sample", fit.source.get("sample")),
        ("Instrument", fit.source.get("instrument")),
        ("Model", f"{models.of_fit(fit).title} ({fit.model})"),
        ("Fit", inputs.name),
    ]
    joint = fit.source.get("joint")
    facts += [("Part of a joint fit", joint["part"])] if joint else []
    facts += stated.facts()
    pairs = [part for k, v in facts for part in (tag("dt", k), tag("dd", v))]
    return tag(
        "header",
        tag("h1", title(fit)),
        _verdict(fit),
        tag("p", _status(fit), class_=f"status {'good' if fit.ok else 'bad'}"),
        tag("dl", *pairs),
        _warnings(fit),
        _absent(inputs),
    )


def title(fit: FitResult) -> str:
    """Model and sample in a few words."""
    sample = fit.source.get("sample")
    name = str(sample).replace("_", " ") if sample else "BRDF samples"
    return f"{name}: {models.of_fit(fit).title}"


def _verdict(fit: FitResult) -> Markup:
    if fit.verdict is None:
        return Markup("")
    line = fit.verdict.line
    good = "good" if fit.verdict.fits else "bad"
    return tag("p", line[0].upper() + line[1:] + ".", class_=f"status {good}", id="verdict")


def _status(fit: FitResult) -> str:
    if fit.status != "converged":
        return "The fit has NOT converged: its values are not a result."
    if fit.posterior is None:
        return "The fit has converged."
    if not fit.posterior.converged:
        return "The fit has converged; its posterior has NOT: do not rely on the intervals."
    return "The fit and its posterior have converged."


def _warnings(fit: FitResult) -> Markup:
    if not fit.warnings:
        return Markup("")
    return tag("div", tag("h2", "Warnings"), items(fit.warnings), class_="warning", id="warnings")


def _absent(inputs: Inputs) -> Markup:
    if not inputs.absent:
        return Markup("")
    note = "Left out of this report, because something is not there:"
    return tag("div", tag("p", note), items(inputs.absent), class_="note", id="absent")


def parameters(fit: FitResult, stated: Statement) -> Markup:
    """Every parameter with its intervals, beside the true value where it is known."""
    model = models.of_fit(fit)
    truth = fit.source.get("truth") or {}
    k = stated.coverage
    head = ["parameter", "meaning", "value ± standard uncertainty"]
    head += [] if k is None else [f"U (k = {k:.4g})"]
    head += ["68 % interval", "95 % interval"]
    head += ["true", "difference / u"] if truth else []
    rows = []
    for name, fitted in fit.parameters.items():
        estimate = fitted.in_file_units()
        true_cells = [] if not truth else _true(estimate, truth.get(name))
        intervals = [interval(estimate, pair) for pair in _intervals(estimate)]
        meaning = model.parameter(name).meaning
        expanded = [] if k is None else [_expanded(estimate, k)]
        shown = _unbroken(recovered(estimate))
        rows.append([name, meaning, shown, *expanded, *intervals, *true_cells])
    kind = (
        "quantiles of the posterior"
        if fit.posterior is not None
        else "from the standard uncertainty, or at a bound from the growth of chi-squared"
    )
    allowance = fit.diagnostics.get("allowance")
    note = f"Intervals: {kind}."
    if allowance:
        note += f" The {allowance['text']}."
    found = fit.diagnostics.get("self_calibration", {}).get("notes", [])
    note += "".join(f" {line[:1].upper()}{line[1:]}." for line in found)
    if truth:
        note += (
            " The true values are those the session was simulated with; the fit did not use them."
        )
    covered = stated.coverage_sentence()
    return section(
        "parameters",
        "Parameters",
        table(head, rows, "Fitted parameters"),
        tag("p", f"{covered} {note}" if covered else note),
    )


def _expanded(estimate: Estimate, k: float) -> str | None:
    """U = k u with the digits of u."""
    if estimate.stderr is None:
        return None
    unit = unit_text(estimate.unit)
    return _unbroken(rounded(k * estimate.stderr, estimate.stderr) + (f" {unit}" if unit else ""))


def _intervals(estimate: Estimate) -> tuple[Any, Any]:
    return estimate.interval_68, estimate.interval_95


def interval(estimate: Estimate, pair: tuple[float, float] | None) -> str | None:
    r"""Two ends with two digits of the width that a standard uncertainty has.

    Examples
    --------
    >>> interval(Estimate(0.2, 0.01, "", None, None, None), (0.18, 0.22))
    '0.180\xa0to\xa00.220'
    """
    if pair is None:
        return None
    u = estimate.stderr or (pair[1] - pair[0]) / 4
    digits = int(np.clip(1 - np.floor(np.log10(u)), 0, 9)) if u > 0 else 6
    unit = unit_text(estimate.unit)
    shown = f"{pair[0]:.{digits}f} to {pair[1]:.{digits}f}" + (f" {unit}" if unit else "")
    return _unbroken(shown.replace("-", "−"))


def _unbroken(line: str) -> str:
    """The text with blanks at which no line breaks."""
    return line.replace(" ", "\u00a0")


def _true(estimate: Estimate, true: float | None) -> list[str | None]:
    if true is None:
        return [None, None]
    shown = f"{true:.6g}" + (f" {unit_text(estimate.unit)}" if estimate.unit else "")
    if not estimate.stderr:
        return [shown, None]
    return [shown, f"{(estimate.value - true) / estimate.stderr:+.1f}".replace("-", "−")]


def goodness(fit: FitResult, residual: Residuals | None) -> list[Markup]:
    """How well the model describes the samples."""
    rows: list[tuple[str, Any]] = [
        ("samples", fit.n_samples),
        ("of them below zero, kept as noise", fit.n_negative),
        ("degrees of freedom", fit.dof),
        ("weights", _WEIGHTS.get(fit.weights, fit.weights)),
        ("loss, engine", f"{fit.loss}, {engine_text(fit.engine, fit.polish)}"),
    ]
    if fit.weights == "sd" and fit.dof > 0:
        ratio = f"{fit.chi2 / fit.dof:.4g}"
        rows.append(("χ² per degree of freedom, by the independent noise", ratio))
        rows.append(("factor on the independent uncertainties", f"{fit.noise_scale:.4g}"))
    else:  # without uncertainties it has a unit and cannot be judged by itself
        rows.append(("χ² per degree of freedom", None))
    if residual is not None and residual.in_uncertainties:
        for k in (1, 2):
            share = np.mean(np.abs(residual.z) <= k)
            rows.append(
                (f"residuals within ±{k} standard uncertainties, scaled", f"{100 * share:.1f} %")
            )
    return [table(["", "value"], rows, "Goodness of fit")]


def convergence(fit: FitResult) -> Markup:
    """How the posterior was sampled."""
    p = fit.posterior
    if p is None:
        return tag("p", f"Posterior: {UNKNOWN}; the fit was made without --posterior.")
    rows = [
        ("converged", "yes" if p.converged else "NO"),
        ("effective draws, fewest of a parameter", f"{p.ess:.0f}"),
        ("split R-hat, largest (below 1.01)", f"{p.r_hat:.4f}"),
        ("autocorrelation time, longest", f"{p.tau:.1f} steps"),
        ("accepted proposals", f"{100 * p.acceptance:.0f} %"),
    ]
    if p.ess_tail is not None:
        rows.insert(2, ("effective draws in the tails (at least 400)", f"{p.ess_tail:.0f}"))
    if p.sampler is not None:
        rows.append(("sampler", p.sampler + (f": {p.note}" if p.note else "")))
    if p.k_hat is not None:
        rows.append(("tail of the importance weights, k-hat (below 0.5)", f"{p.k_hat:.2f}"))
    rows += [(f"prior of {name}", text) for name, text in p.priors.items() if text != "flat"]
    return table(["", "value"], rows, "Convergence of the posterior")


def parameter_budget(fit: FitResult, stated: Statement) -> Markup:
    """Standard uncertainty of every parameter by source."""
    sources = list(dict.fromkeys(s for parts in shares(fit).values() for s in parts))
    shown = {name: estimate.in_file_units() for name, estimate in fit.parameters.items()}
    head = ["source", *(_with_unit(name, estimate) for name, estimate in shown.items())]
    rows: list[list[Any]] = [[s, *(_part(e, s) for e in shown.values())] for s in sources]
    rows.append(["combined", *(_two_digits(e.stderr) for e in shown.values())])
    if (k := stated.coverage) is not None:
        every = [None if e.stderr is None else k * e.stderr for e in shown.values()]
        rows.append([f"expanded, k = {k:.4g}", *map(_two_digits, every)])
    return table(head, rows, "Standard uncertainty of the parameters by source")


def _with_unit(name: str, estimate: Estimate) -> str:
    return name + (f" ({unit_text(estimate.unit)})" if estimate.unit else "")


def _part(estimate: Estimate, source: str) -> str | None:
    u = estimate.components.get(source)
    if u is not None and estimate.stderr and u < _NIL * estimate.stderr:
        return "≈ 0"  # rounding of a source that does not act on this parameter
    return _two_digits(u)


def _two_digits(u: float | None) -> str | None:
    return None if u is None else f"{u:.2g}"


def sample_budget(inputs: Inputs) -> Markup:
    """The budget of the samples themselves, as `gonio budget` gives it."""
    from gonio.calibration.budget import budget

    if inputs.samples is None:
        return Markup("")
    try:
        report = budget(inputs.samples).describe(None)
    except GonioError as error:
        return tag("p", f"Budget of the samples: {UNKNOWN}. {error}")
    rows = [
        [row["name"], row["meaning"], row["kind"], row["shared_by"], *_percents(row["relative"])]
        for row in report["sources"]
    ]
    rows.append(["combined", "", "", "", *_percents(report["combined"])])
    head = ["source", "meaning", "type", "shared by", "median (%)", "5 % (%)", "95 % (%)"]
    caption = (
        "Relative standard uncertainty of the samples by source: median, 5th and 95th percentile"
    )
    return table(head, rows, caption)


def _percents(summary: dict[str, float] | None) -> list[str | None]:
    if summary is None:
        return [None, None, None]
    return [f"{100 * summary[key]:.3g}" for key in ("median", "p5", "p95")]


def unknown(fit: FitResult) -> Markup:
    """Effects whose size nobody stated: no value of the report contains them."""
    effects = [str(line) for line in fit.source.get("unknown") or ()]
    if not effects:
        return Markup("")
    lines = items(f"{line}: {UNKNOWN}" for line in effects)
    return tag(
        "div", tag("p", "No value of this report contains:"), lines, class_="note", id="unknown"
    )


def measurement(inputs: Inputs) -> Markup:
    """Instrument, session, findings, and the history of the data."""
    fit, session = inputs.fit, inputs.session
    rows = [("instrument", fit.source.get("instrument")), ("sample", fit.source.get("sample"))]
    rows += _session_rows(session)
    findings = [_finding(f) for f in fit.source.get("findings") or ()]
    history = fit.diagnostics.get("history") or (inputs.samples.history if inputs.samples else ())
    return section(
        "measurement",
        "Instrument and session",
        table(["", ""], rows, "Instrument and session"),
        tag("h3", "Findings"),
        items(findings) if findings else tag("p", _no_findings(fit)),
        tag("h3", "History"),
        tag("ol", *(tag("li", line) for line in history)) if history else tag("p", UNKNOWN),
    )


def _no_findings(fit: FitResult) -> str:
    return "None was recorded." if "findings" in fit.source else f"Findings: {UNKNOWN}."


def _finding(finding: Any) -> str:
    return (
        "; ".join(f"{k}: {v}" for k, v in finding.items()) if isinstance(finding, dict) else finding
    )


def _session_rows(session: Session | None) -> Iterable[tuple[str, Any]]:
    if session is None:
        return []
    from gonio.calibration.effects import all_effects
    from gonio.calibration.frames import certified

    m, plan = session.metadata, session.metadata.plan
    g = m.geometry
    return [
        ("geometry", f"{g.shape}, R = {g.R:g} mm, D = {g.D:g} mm"),
        ("lens", f"{m.lens.projection}, f = {m.lens.focal_length_mm:.4g} mm"),
        ("frames", f"{m.camera.columns} × {m.camera.rows} pixels, {session.n_done} of "
                   f"{plan.n_frames} there"),
        ("incidences", _degrees(plan.theta_i_deg)),
        ("turns of the sample", _degrees(plan.rotations_deg)),
        ("exposures", ", ".join(f"{1e3 * t:.4g}" for t in plan.exposures_s) + " ms"),
        ("white standard", certified.describe(m.standard)),
        *((each.words, each.text(m)) for effect in all_effects() for each in effect.quantities),
    ]  # fmt: skip


def _degrees(angles: tuple[float, ...]) -> str:
    if len(angles) > 12:
        return f"{len(angles)}, {min(angles):g} to {max(angles):g}°"
    return ", ".join(f"{a:g}" for a in angles) + "°"


def reproduce(inputs: Inputs) -> Markup:
    """Command lines, seed, versions and hashes."""
    fit = inputs.fit
    rows = [
        ("seed", fit.seed),
        ("SHA-256 of the samples' numbers", _hash(fit.source.get("data_sha256"))),
        ("SHA-256 of the file", _hash(fit.source.get("sha256"))),
        *((f"version of {name}", version) for name, version in fit.versions.items()),
    ]
    lines = commands(inputs)
    return section(
        "reproduce",
        "How to reproduce",
        tag("pre", tag("code", "\n".join(lines))) if lines else tag("p", f"Input: {UNKNOWN}."),
        tag("p", "Starting values given with --start are not recorded and not in these lines."),
        table(["", ""], rows, "Seed, versions and data"),
    )


def _hash(digest: object) -> Markup | None:
    return None if digest is None else tag("code", digest, class_="hash")


def commands(inputs: Inputs) -> list[str]:
    """The command lines that make the fit again."""
    fit = inputs.fit
    source = fit.source.get("input") or fit.source.get("path")
    if not source:
        return []
    session = fit.source.get("session")
    lines = []
    if session and Path(str(session)).name != Path(str(source)).name:
        lines.append(["gonio", "reduce", str(session), "-o", str(source)])
    joint = fit.source.get("joint") or {}
    sources = joint.get("input") or source
    sources = sources if isinstance(sources, list) else [sources]
    arguments = ["gonio", "fit", *map(str, sources), "--model", fit.model, "--weights", fit.weights]
    arguments += ["--loss", fit.loss] if fit.loss != "chi2" else []
    arguments += ["--engine", fit.engine]
    arguments += ["--share", ",".join(joint["share"]) or "none"] if joint else []
    for key, value in (joint.get("select", fit.cuts.get("select")) or {}).items():
        arguments += ["--select", f"{key}={value}"]
    for angle in ("theta_i", "theta_r"):
        limit = fit.cuts.get(f"max_{angle}_deg")
        arguments += [] if limit is None else [f"--max-{angle.replace('_', '-')}", f"{limit:g}"]
    if fit.posterior is not None:
        arguments += ["--posterior", "--sampler", fit.posterior.sampler or "emcee"]
    arguments += ["--seed", str(fit.seed)]
    arguments += ["--truth", str(session)] if fit.source.get("truth") and session else []
    lines.append([*arguments, "-o", inputs.name])
    page = [inputs.name, "-o", str(Path(inputs.name).with_suffix(".html"))]
    page += ["--select", f"part={joint['part']}"] if joint else []
    lines.append(["gonio", "report", *page])
    return [shlex.join(line) for line in lines]


def reference(fit: FitResult) -> Markup:
    """Formula and source of the model."""
    model = models.of_fit(fit)
    return tag("p", text(f"{model.title}. {model.reference}."))
