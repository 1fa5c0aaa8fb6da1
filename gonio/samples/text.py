"""Short descriptions of samples, for a prompt and for a notebook."""

from __future__ import annotations

from html import escape

import numpy as np

from gonio.samples.record import ANGLES, SampleRecord

ROWS = 5  # samples that a notebook shows
MOST_NAMES = 6


def facts(samples: SampleRecord) -> list[tuple[str, str]]:
    """Name and text of each fact about the samples."""
    n = len(samples)
    rows: list[tuple[str, str]] = []
    rows.append((str(samples.quantity), f"{n} values{_range(samples.value, ' sr^-1')}"))
    for name in ("theta_i", "theta_r"):
        angle = np.degrees(np.broadcast_to(getattr(samples.directions, name), (n,)))
        rows.append((name, _range(angle, " deg").removeprefix(", ") or "none"))
    u = samples.u_independent
    shown = "not stated" if u is None else _range(u, " sr^-1").removeprefix(", ")
    rows.append(("u_brdf", shown))
    if samples.channel is not None:
        rows.append(("channels", _names(list(map(str, np.unique(samples.channel))))))
    if samples.wavelength_nm is not None:
        nm = [f"{v:g}" for v in np.unique(samples.wavelength_nm)]
        rows.append(("wavelengths", f"{_names(nm)} nm"))
    if samples.cells is not None:
        rows.append(("cells", f"{len(samples.cells.weight)} members"))
    if samples.shared:
        rows.append(("shared errors", _names([term.name for term in samples.shared])))
    return rows


def short(samples: SampleRecord) -> str:
    """One line."""
    words = facts(samples)
    return f"<BRDFSamples {'; '.join(f'{name}: {text}' for name, text in words)}>"


def html(samples: SampleRecord) -> str:
    """A table of facts about the samples, and the first samples."""
    about = "".join(
        f'<tr><td style="text-align:left">{escape(name)}</td>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for name, text in facts(samples)
    )
    n = min(ROWS, len(samples))
    angles = [
        np.degrees(np.broadcast_to(getattr(samples.directions, a), (len(samples),))[:n])
        for a in ANGLES
    ]
    columns = [*angles, samples.value[:n]]
    head = [*(f"{a} [deg]" for a in ANGLES), "brdf [sr^-1]"]
    if samples.u_independent is not None:
        columns.append(samples.u_independent[:n])
        head.append("u_brdf [sr^-1]")
    cells = "".join(f"<th>{escape(name)}</th>" for name in head)
    rows = "".join(
        "<tr>" + "".join(f"<td>{value:.6g}</td>" for value in row) + "</tr>"
        for row in zip(*columns, strict=True)
    )
    more = f"<p>and {len(samples) - n} more samples</p>" if len(samples) > n else ""
    return (
        f"<div><p><strong>BRDFSamples</strong></p><table><tbody>{about}</tbody></table>"
        f"<table><thead><tr>{cells}</tr></thead><tbody>{rows}</tbody></table>{more}</div>"
    )


def _range(values: np.ndarray, unit: str) -> str:
    if not values.size:
        return ""
    low, high = f"{values.min():.4g}", f"{values.max():.4g}"
    return f", {low}{unit}" if low == high else f", {low} to {high}{unit}"


def _names(names: list[str]) -> str:
    if len(names) <= MOST_NAMES:
        return ", ".join(names)
    return f"{len(names)}: {', '.join(names[: MOST_NAMES - 1])}, ..."
