"""Raw frames with the reflected angles drawn over them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, SubFigure
from numpy.typing import ArrayLike

from gonio.calibration import reflector
from gonio.calibration.frames.exposure import merge
from gonio.calibration.lens import projection as lens
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray
from gonio.metadata import Metadata
from gonio.plotting.style import ORANGE, SKY, VERMILLION, _new_figure, nothing_to_draw, style
from gonio.session import Session

CIRCLES_DEG = (30.0, 60.0)
LEAST_PERCENTILE = 0.5  # of the rates inside the rim; a third of that is black
DECADES = 5.0  # most that the grey scale spans


def frames(
    session: Session,
    incidences: Sequence[int] | None = None,
    axes: Sequence[Axes] | None = None,
    *,
    take: int = 0,
) -> list[Axes]:
    """Sample frames at a few incidence angles: the exposures merged, logarithmic grey scale.

    Parameters
    ----------
    session : Session
    incidences : sequence of int, optional
        Indices of the plan's incidence angles; the first, a middle one and the last by default.
    axes : sequence of Axes, optional
        One for each frame; new ones where not given.
    take : int
        Index of the rotation.

    Returns
    -------
    list of Axes
        The frames' axes; the colour bar stands beside the last.

    Raises
    ------
    ConfigurationError
        If an incidence is not in the plan, or the number of axes is not that of the frames.
    DataError
        If a frame is missing or damaged, or no pixel has a signal.

    Notes
    -----
    Dashed circles are reflected polar angles by Ward's eq. (3); the outermost is the rim up to
    which the dome is usable. The specular and the retro direction are marked.
    """
    metadata = session.metadata
    chosen = default_incidences(metadata) if incidences is None else list(incidences)
    _check(metadata, chosen, axes)
    images = [_rate(session, take, k) for k in chosen]
    norm = _grey_scale(metadata, images)
    with style():
        if axes is None:
            figure = _new_figure(3.2 * len(chosen) + 0.6, 3.4)
            axes = list(np.ravel(figure.subplots(1, len(chosen))))
        for number, (ax, incidence, image) in enumerate(zip(axes, chosen, images, strict=True)):
            _draw(ax, metadata, metadata.plan.theta_i_deg[incidence], image, norm)
            _circles(ax, metadata, symbol=number == 0)
            if number:
                ax.set_ylabel("")
        _colour_bar(list(axes))
    return list(axes)


def default_incidences(metadata: Metadata) -> list[int]:
    """Indices of the first, a middle and the last incidence angle, in the order of the angles."""
    theta = np.array(metadata.plan.theta_i_deg)
    angles = np.linspace(theta.min(), theta.max(), 3)
    return list(dict.fromkeys(int(np.argmin(np.abs(theta - angle))) for angle in angles))


def pixel_of(
    metadata: Metadata, theta_r: ArrayLike, phi_r: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Fractional column and row at which the camera receives a reflected direction.

    Angles are in radians, in the laboratory frame. The result is NaN outside the image circle.
    """
    camera, geometry = metadata.camera, metadata.geometry
    theta_c, phi_c = reflector.camera_angles(theta_r, phi_r, R=geometry.R, D=geometry.D)
    # The calibration leads from the sensor to angles; a table inverts it.
    half = np.hypot(camera.columns * camera.pitch_mm[0], camera.rows * camera.pitch_mm[1]) / 2
    radius = np.linspace(0, half, 4097)
    theta, _ = lens.camera_angles(metadata.lens, radius, np.zeros_like(radius))
    inside = np.isfinite(theta)
    r = np.interp(theta_c, theta[inside], radius[inside], right=np.nan)
    column = r * np.cos(phi_c) / camera.pitch_mm[0] + (camera.columns - 1) / 2
    row = r * np.sin(phi_c) / camera.pitch_mm[1] + (camera.rows - 1) / 2
    return np.asarray(column), np.asarray(row)


def _check(metadata: Metadata, chosen: list[int], axes: Sequence[Axes] | None) -> None:
    n = len(metadata.plan.theta_i_deg)
    for incidence in chosen:
        if not 0 <= incidence < n:
            raise ConfigurationError(
                f"incidence {incidence} is not of the session's plan; it has 0 to {n - 1}.",
                value=incidence,
            )
    if axes is not None and len(axes) != len(chosen):
        raise ConfigurationError(
            f"{len(axes)} axes were given for {len(chosen)} frames; give one for each."
        )


def _rate(session: Session, take: int, incidence: int) -> FloatArray:
    """Photo-electrons a second, dark current subtracted, NaN where saturated."""
    camera, plan = session.metadata.camera, session.metadata.plan
    rate = merge(session.bracket("sample", take, incidence), plan.exposures_s, camera)
    used = (rate.time > 0) & ~rate.saturated
    return np.where(used, rate.value - camera.dark_e_per_s, np.nan)


def _theta_r(metadata: Metadata) -> FloatArray:
    """Reflected polar angle of every pixel, radians, NaN outside the image circle."""
    camera, geometry = metadata.camera, metadata.geometry
    columns, rows = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    theta_c, phi_c = lens.camera_angles(metadata.lens, *lens.pixel_positions(camera, columns, rows))
    return reflector.reflected_angles(theta_c, phi_c, R=geometry.R, D=geometry.D)[0]


def _grey_scale(metadata: Metadata, images: list[FloatArray]) -> LogNorm:
    """One scale for all frames, from the dim end of the usable pixels to the brightest."""
    usable = _theta_r(metadata) <= np.radians(metadata.geometry.usable_theta_r_deg)
    inside = np.concatenate([image[usable] for image in images])
    lit = inside[np.isfinite(inside) & (inside > 0)]
    if not len(lit):
        raise nothing_to_draw("no pixel of these frames has a signal that is not saturated")
    top = float(lit.max())
    bottom = max(float(np.percentile(lit, LEAST_PERCENTILE)) / 3, top / 10**DECADES)
    return LogNorm(bottom if bottom < top else top / 10, top, clip=True)


def _draw(
    ax: Axes, metadata: Metadata, theta_i_deg: float, image: FloatArray, norm: LogNorm
) -> None:
    # Rows grow upwards, so that azimuths run counter-clockwise; dark pixels are black, not absent.
    shown = np.where(image <= norm.vmin, norm.vmin, image) if norm.vmin is not None else image
    ax.imshow(shown, cmap="gray", norm=norm, origin="lower", interpolation="nearest")
    ax.set_facecolor(SKY)
    _mark(ax, metadata, theta_i_deg, 180.0, "o", VERMILLION, "specular")
    _mark(ax, metadata, theta_i_deg, 0.0, "s", SKY, "retro")
    _frame(ax, metadata)
    ax.set_title(rf"$θ_{{\mathrm{{i}}}}$ = {theta_i_deg:g}°")


def _circles(ax: Axes, metadata: Metadata, *, symbol: bool) -> None:
    """Circles of equal theta_r, each with its angle; `symbol` writes theta_r before the first."""
    rim = metadata.geometry.usable_theta_r_deg
    azimuth = np.linspace(0, 2 * np.pi, 361)
    for circle in (*(c for c in CIRCLES_DEG if c < rim), rim):
        x, y = pixel_of(metadata, np.radians(circle), azimuth)
        ax.plot(x, y, color=ORANGE, linewidth=0.8, linestyle="-" if circle == rim else "--")
        x, y = pixel_of(metadata, np.radians(circle), -np.pi / 2)
        prefix = r"$θ_{\mathrm{r}}$ = " if symbol else ""
        ax.annotate(
            f"{prefix}{circle:g}°", (float(x), float(y)), (0, 2), textcoords="offset points",
            ha="center", va="bottom", fontsize=7, color=ORANGE,
            bbox={"facecolor": "black", "alpha": 0.55, "pad": 0.8, "linewidth": 0},
        )  # fmt: skip


def _mark(
    ax: Axes,
    metadata: Metadata,
    theta_deg: float,
    phi_deg: float,
    marker: str,
    colour: str,
    label: str,
) -> None:
    x, y = pixel_of(metadata, np.radians(theta_deg), np.radians(phi_deg))
    ax.plot(
        x, y, marker, color=colour, markersize=8 if marker == "o" else 10, label=label,
        markerfacecolor="none", markeredgewidth=1.2, linestyle="none",
    )  # fmt: skip


def _frame(ax: Axes, metadata: Metadata) -> None:
    """Axis limits around the rim, and a few ticks in pixels."""
    rim = np.radians(metadata.geometry.usable_theta_r_deg)
    x, y = pixel_of(metadata, rim, np.linspace(0, 2 * np.pi, 361))
    margin = 0.04 * float(np.nanmax(x) - np.nanmin(x))
    ax.set_xlim(np.nanmin(x) - margin, np.nanmax(x) + margin)
    ax.set_ylim(np.nanmin(y) - margin, np.nanmax(y) + margin)
    ax.locator_params(nbins=4)
    ax.set_xlabel("column (pixel)")
    ax.set_ylabel("row (pixel)")


def _colour_bar(axes: list[Axes]) -> None:
    figure: Figure | SubFigure = axes[-1].figure
    bar = figure.colorbar(axes[-1].images[0], ax=axes, pad=0.01, aspect=24, fraction=0.04)
    bar.set_label("signal (photo-electrons / s)")
    axes[0].legend(
        loc="upper left", bbox_to_anchor=(0, 1), labelcolor="white", handletextpad=0.2,
        borderaxespad=0.1, fontsize=7,
    )  # fmt: skip
