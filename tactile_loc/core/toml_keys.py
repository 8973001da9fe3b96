"""What the TOML files of sensors, touches and priors share: kinds of numbers, and what to say when a key is wrong."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from tactile_loc.core.errors import did_you_mean

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def explain(
    error: ValidationError, model: type[BaseModel], values: dict[str, Any], what: str, decisive: str = ""
) -> str:
    """Say in one sentence which key of `what`, a table of `model`'s keys, is wrong, and what is allowed.

    The key `decisive`, on which the others depend, is named before them, and unknown keys before ill-typed ones. A
    field's description completes "key must be ...".
    """
    problems = sorted(error.errors(), key=lambda p: (p["loc"][0] != decisive, p["type"] != "extra_forbidden"))
    key = str(problems[0]["loc"][0])
    field = model.model_fields.get(key)
    if field is None:
        known = model.model_fields
        return f"{what} has no key {key!r}.{did_you_mean(key, known)} Its keys: {', '.join(known)}"
    must_be = f"it must be {field.description}"
    return f"{key} = {values[key]!r} is wrong; {must_be}" if key in values else f"{key} is missing; {must_be}"
