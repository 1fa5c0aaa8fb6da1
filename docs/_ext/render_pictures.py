"""The pictures of the page on rendering, and the figures of the papers that are pictures."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from gonio import materials
from gonio.geometry import FloatArray
from gonio.plotting import save, style
from gonio.plotting.style import BLUE, VERMILLION
from gonio.rendering import (
    Directional,
    cross_section,
    lift_of,
    plate,
    plate_reference,
    render,
    scene,
    srgb,
    white_of,
)

DEG = math.pi / 180
WIDTH = 4.6  # inches
VASE = 0.7, 40 * DEG  # rho and sigma of the clay vase, Oren & Nayar 1994, Fig. 12


def write(folder: Path) -> None:
    """Write all pictures."""
    for name, draw in PICTURES.items():
        draw(folder / name)


def rough(rho: float, sigma: float) -> dict[str, float]:
    return {"rho": rho, "sigma": sigma}


def panels(path: Path, images: dict[str, FloatArray], white: float, columns: int = 2) -> None:
    """Pictures of one shape in rows, narrow enough for a telephone; one white for all."""
    import matplotlib.pyplot as plt

    rows = -(-len(images) // columns)
    first = next(iter(images.values()))
    width = WIDTH / columns
    with style():
        figure, axes = plt.subplots(
            rows, columns, figsize=(WIDTH, rows * (width * first.shape[0] / first.shape[1] + 0.2)),
            squeeze=False, layout="constrained",
        )  # fmt: skip
        for ax in axes.flat:
            ax.set_axis_off()
        for ax, (name, image) in zip(axes.flat, images.items(), strict=False):
            show(ax, image, white, name)
    save(figure, path)
    plt.close(figure)


def show(ax: Axes, image: FloatArray, white: float, name: str, lift: float = 0.0) -> None:
    ax.set_axis_on()
    ax.imshow(srgb(image, white, lift), cmap="gray", vmin=0, vmax=255)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_xlabel(name)
    for spine in ax.spines.values():
        spine.set_visible(False)


def spheres(path: Path) -> None:
    """Fig. 14: spheres lit from the viewer, more and more rough."""
    images = {
        f"σ = {sigma}°": render(
            "sphere", Directional(), "oren_nayar", rough(0.9, sigma * DEG), size=(150, 150)
        )
        for sigma in (0, 10, 20, 40)
    }
    panels(path, images, 1.0)


def defaults(path: Path) -> None:
    """What 'gonio render sphere' draws of several materials when nothing else is said."""
    import matplotlib.pyplot as plt

    names = ("rolled_aluminum", "rolled_brass", "varnished_plywood", "glossy_grey_paper",
             "white_ceramic_tile", "wall_plaster")  # fmt: skip
    light = Directional(*scene("sphere").light)
    with style():
        figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 3.4), layout="constrained")
        for ax, name in zip(axes.flat, names, strict=True):
            material = materials.get(name)
            image = render("sphere", light, material.model, material.parameters, size=(150, 150))
            white = white_of(image)
            show(ax, image, white, name.replace("_", " "), lift_of(image, white))
    save(figure, path)
    plt.close(figure)


def vase(path: Path) -> None:
    """Figs 12 and 13: the vase and the brightness across it."""
    import matplotlib.pyplot as plt

    with style():
        figure = plt.figure(figsize=(WIDTH, 5.2), layout="constrained")
        axes = figure.subplots(2, 2, height_ratios=[1.2, 1]).ravel()
        for ax, sigma in zip(axes[:2], (0.0, VASE[1]), strict=True):
            image = render(
                "vase", Directional(), "oren_nayar", rough(VASE[0], sigma), size=(210, 150)
            )
            show(ax, image, 0.8, f"σ = {sigma / DEG:.0f}°")
        for ax, theta_i in zip(axes[2:], (0.0, 20 * DEG), strict=True):
            for name, sigma, colour, line in (
                ("Lambert", 0.0, BLUE, "--"), ("σ = 40°", VASE[1], VERMILLION, "-")
            ):  # fmt: skip
                x, radiance = cross_section("oren_nayar", rough(VASE[0], sigma), theta_i=theta_i)
                shown = radiance / radiance.max()
                ax.plot(x, shown, color=colour, linestyle=line, label=name)
            ax.set_title(rf"$θ_{{\mathrm{{i}}}}$ = {theta_i / DEG:.0f}°")
            ax.set_xlabel("place across the vase (radii)")
            ax.set_ylim(0, 1.05)
        axes[2].set_ylabel("radiance / its maximum")
        axes[2].legend(loc="lower center")
    save(figure, path)
    plt.close(figure)


def objects(path: Path) -> None:
    """Fig. 15: three matte objects."""
    drawn = scene("objects")
    images = {
        f"σ = {sigma}°": render(
            drawn, Directional(*drawn.light), "oren_nayar", rough(0.9, sigma * DEG),
            size=(178, 300),
        )
        for sigma in (0, 30)
    }  # fmt: skip
    panels(path, images, 1.0, columns=1)


def grooves(path: Path) -> None:
    """The highlight of rolled aluminum lies across its grooves."""
    aluminum = materials.get("rolled_aluminum").parameters
    images = {
        name: render("sphere", Directional(30 * DEG, 45 * DEG), "ward", aluminum, turn=turn,
                     size=(150, 150))
        for name, turn in (("grooves around", 0.0), ("grooves upright", math.pi / 2))
    }  # fmt: skip
    panels(path, images, 1.5)


def ward(path: Path) -> None:
    """Ward's Fig. 7, with what it should be and what counting twice does."""
    brass = materials.get("rolled_brass").parameters
    exact = plate_reference("ward", brass)
    names = {
        "deterministic": "eq. (6) without rays", "monte_carlo": "rays alone",
        "hybrid": "eq. (6)", "double_counted": "the lamp twice",
    }  # fmt: skip
    images = {"quadrature": exact}
    for method, name in names.items():
        images[name] = plate(
            method, "ward", brass, n=20 if method == "monte_carlo" else 16
        ).radiance
    panels(path, images, float(np.percentile(exact, 99)), columns=3)


PICTURES = {
    "materials.png": defaults,
    "spheres.png": spheres,
    "vase.png": vase,
    "objects.png": objects,
    "grooves.png": grooves,
    "plate.png": ward,
}
