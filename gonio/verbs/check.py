"""Check of a model against its claims, or of BRDF samples for what is implausible in them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import overload

import gonio.formats as formats
import gonio.materials as materials
import gonio.models as models
from gonio.checks import ModelReport, SamplesReport, check_model, check_samples
from gonio.errors import ConfigurationError, unknown_name
from gonio.models import Model
from gonio.samples import BRDFSamples
from gonio.verbs.surface import named_surface


@overload
def check(target: Model, parameters: Mapping[str, float] | None = None) -> ModelReport: ...
@overload
def check(target: BRDFSamples | Path) -> SamplesReport: ...
@overload
def check(
    target: Model | BRDFSamples | Path | str,
    parameters: Mapping[str, float] | None = None,
    *,
    select: Mapping[str, str] | None = None,
) -> ModelReport | SamplesReport: ...


def check(
    target: Model | BRDFSamples | Path | str,
    parameters: Mapping[str, float] | None = None,
    *,
    select: Mapping[str, str] | None = None,
) -> ModelReport | SamplesReport:
    """Check a model or BRDF samples for reciprocity, energy and plausibility.

    A model is tested against its claims. Samples are asked whether they can be what they claim:
    angles, unit, quantity, and values that are no measurements. A fit asks the same.

    Parameters
    ----------
    target : Model, BRDFSamples, path or str
        A model, a model or material by name, samples, or a file of samples.
    parameters : mapping of str to float, optional
        Parameters of the model, radians for angles.
    select : mapping of str to str, optional
        Samples of a file to check, such as ``{"wavelength": "650"}``.

    Returns
    -------
    ModelReport or SamplesReport
        ``passed`` says whether every claim holds, or whether nothing in the samples would make a
        fit warn or refuse; ``findings`` lists what would.

    Raises
    ------
    ConfigurationError
        For an unknown name, parameters of samples, or a selection of a model.
    DataError
        If a file cannot be read.

    Examples
    --------
    >>> check("lambert", {"rho": 0.5}).passed
    True
    """
    surface = named_target(target)
    if surface is not None:
        if select:
            raise ConfigurationError(f"{target} is a model; a selection is for files of samples.")
        model, values = surface
        return check_model(model, values | dict(parameters or {}))
    if parameters:
        raise ConfigurationError(f"{target}: samples have no parameters; leave them out.")
    if isinstance(target, BRDFSamples):
        return check_samples(formats.choose(target, select) if select else target)
    assert isinstance(target, str | Path)
    return check_samples(formats.read(Path(target), select=select))


def named_target(
    target: Model | BRDFSamples | Path | str,
) -> tuple[Model, dict[str, float]] | None:
    """The model that a target names, with the parameters of a material; None for samples.

    Raises
    ------
    ConfigurationError
        If it is neither a model, a material nor a file.
    """
    if isinstance(target, Model):
        return target, {}
    if isinstance(target, BRDFSamples | Path):
        return None
    if models.external.is_file(target) and ".py" in target:
        return models.resolve(target), {}
    path = Path(target)
    if target in models.names() or ("+" in target and not path.exists() and not path.suffix):
        return models.get(target), {}
    if target in materials.names():
        model, _ = named_surface(None, target, None)
        return model, dict(materials.get(target).parameters)
    if not path.exists() and path.name == target and not path.suffix:
        raise unknown_name("model, material or file", target, [*models.names(), *materials.names()])
    return None
