"""Options of `gonio fit` for the posterior: sampler and priors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.fitting.posterior.priors import Prior
    from gonio.models import Model


def posterior_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --posterior, --sampler and --prior to a command."""
    options = [
        click.option("--posterior", is_flag=True, help="Sample the posterior."),
        click.option(
            "--sampler",
            type=click.Choice(["emcee", "marginal", "auto"]),
            default="emcee",
            show_default=True,
            help="Sampler of the posterior: emcee, or the faster marginal sampler, which emcee "
            "replaces if its checks fail; auto does so without a warning.",
        ),
        click.option(
            "--prior",
            "priors",
            multiple=True,
            metavar="NAME=PRIOR",
            help="Prior of a parameter: flat, log, normal(mean, sd), lognormal(median, factor) or "
            "half_normal(sd), in the unit of files (degrees for angles).",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def read_priors(items: tuple[str, ...], model: Model, *, posterior: bool) -> dict[str, str | Prior]:
    """Priors by parameter from texts in the unit of files, split at the first equals sign.

    The prior of an unknown name remains a text, which the fit refuses.

    Raises
    ------
    ConfigurationError
        If no posterior is requested, or an item is not NAME=PRIOR, is given twice or is no prior.
    """
    if items and not posterior:
        raise ConfigurationError(
            "--prior changes the posterior alone, and none was asked for; add --posterior."
        )
    from gonio.fitting.posterior.priors import parse

    by_name = {q.name: q for q in model.parameters}
    priors: dict[str, str | Prior] = {}
    for item in items:
        name, _, text = (part.strip() for part in item.partition("="))
        if not (name and text):
            raise ConfigurationError(
                f"--prior {item!r} is not NAME=PRIOR; write for example "
                "--prior 'alpha_x=normal(0.1, 0.02)'.",
                value=item,
            )
        if name in priors:
            raise ConfigurationError(f"--prior {name} is given twice; give it once.", value=item)
        q = by_name.get(name.partition("[")[0])
        priors[name] = text if q is None else parse(replace(q, name=name), text)
    return priors
