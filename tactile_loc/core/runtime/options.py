"""Base class for the options of components."""

from pydantic import BaseModel, ConfigDict


class ComponentOptions(BaseModel):
    """Base class for the options of components. Options are frozen, and refuse infinity, NaN and unknown keys.

    A field's description states its unit. A field that cannot change any result, such as the device, is marked with
    `json_schema_extra={"neutral": True}`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def neutral(cls) -> set[str]:
        """Return the names of the options that cannot change any result."""
        extras = {name: field.json_schema_extra for name, field in cls.model_fields.items()}
        return {name for name, extra in extras.items() if isinstance(extra, dict) and extra.get("neutral")}
