"""Reflectance models from text, as files and the command line spell them."""

from __future__ import annotations

import dataclasses

from torchprt.brdf.models import GGX, BlinnPhong, Brdf, Lambert, Model, Phong, Ward
from torchprt.errors import InputError

_MODELS: dict[str, type[Model]] = {model.name: model for model in (Lambert, Phong, BlinnPhong, GGX, Ward)}
_EXAMPLES = "lambert, phong:40, blinn:40, ggx:0.3, ggx:0.3,0.04, ward:0.1,0.4"


def parse(text: str) -> Brdf:
    """The model that `text` names: a name, a colon, its numbers in the order of the arguments, with commas between.

    "lambert", "phong:40", "blinn:40", "ggx:0.3" (a conductor), "ggx:0.3,0.04" (with f0), "ward:0.1,0.4".
    Law: parse(brdf.spec) == brdf for every model whose parameters are numbers.
    Raises InputError for another name, another count of numbers, or numbers out of range.
    """
    name, colon, rest = text.strip().partition(":")
    if name in ("tabulated", "measured"):
        raise InputError(f"reflectance '{text}' is not in the text: give the table or the function itself again")
    if name not in _MODELS:
        raise InputError(f"reflectance '{text}' is unknown: use one of {_EXAMPLES}")
    fields = dataclasses.fields(_MODELS[name])  # type: ignore[arg-type]
    parts = rest.split(",") if colon else []
    least = sum(field.default is dataclasses.MISSING for field in fields)
    if not least <= len(parts) <= len(fields):
        names = ", ".join(field.name for field in fields) or "nothing"
        raise InputError(f"reflectance '{text}' has {len(parts)} numbers: '{name}' takes {names}, as in {_EXAMPLES}")
    try:
        numbers = [float(part) for part in parts]
    except ValueError as fault:
        raise InputError(
            f"reflectance '{text}' holds something that is not a number: write it as {_EXAMPLES}"
        ) from fault
    try:
        return _MODELS[name](*numbers)
    except InputError as fault:
        raise InputError(f"reflectance '{text}': {fault}") from fault
