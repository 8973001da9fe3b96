"""The configuration of a run: object, touch, the component of each slot, and all options."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator
from pydantic_core import PydanticCustomError

from tactile_loc.core.poses.tolerance import EXPECTED, ONE_MILLIMETRE, Tolerance
from tactile_loc.core.runtime.errors import ConfigError, did_you_mean
from tactile_loc.core.sensing.depth_maps import DepthUnit, TouchKind
from tactile_loc.core.sensing.noise import NoiseLevel
from tactile_loc.io.options import CERTAIN, TUNABLE, HypothesisOptions, SearchOptions, StrictModel, TrackerOptions
from tactile_loc.io.toml import parse_value, read_toml, scale
from tactile_loc.slots.options import validate_options
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc.store.files import recover_folder

COMMAND_LINE = "the command line"  # the source of a configuration without a file
OPTIONS = {
    "top": "`top`",
    "seed": "`seed`",
    "coverage": "`coverage`",
    "tolerance": "`tolerance`",
    "touch.press_depth_mm": "`press_depth`",
}


class SlotConfig(StrictModel):
    """One slot: the component's name and its options. In TOML, this is a table with `name` and the options."""

    name: str
    options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _unfold(cls, value: Any) -> Any:
        """Accept "icp" and {name = "icp", max_iterations = 30} as well as the full form."""
        if isinstance(value, str):
            return {"name": value}
        if isinstance(value, dict) and "options" not in value:
            return {"name": value.get("name"), "options": {k: v for k, v in value.items() if k != "name"}}
        if not isinstance(value, dict | SlotConfig):
            raise PydanticCustomError("slot", "it must be a component's name, or a table of its name and options")
        return value


class ObjectConfig(StrictModel):
    """The object: a mesh file or the name of a demo object, with its unit and symmetry."""

    path: str = "hook"
    units: Literal["m", "mm", "cm", "inch", "auto"] = "auto"
    symmetry: str = "auto"


class TouchConfig(StrictModel):
    """The touch: a file, and the unit, the kind and the press depth (mm) of its depths if the file does not state them.

    Without a file, a touch is simulated with `noise`.
    """

    path: str | None = None
    unit: DepthUnit | None = None
    kind: TouchKind | None = None
    press_depth_mm: float | None = None
    noise: NoiseLevel = "none"

    @property
    def press_depth_m(self) -> float | None:
        """The press depth, metres, or None if the file states the press depth."""
        return scale(self.press_depth_mm)


def _read_tolerance(value: Any) -> Any:
    """Convert a text such as "0.5mm,2deg" to a tolerance."""
    if isinstance(value, Tolerance):
        return value
    try:
        return Tolerance.parse(str(value))
    except ConfigError as error:
        raise PydanticCustomError("tolerance", EXPECTED) from error


ToleranceText = Annotated[Tolerance, BeforeValidator(_read_tolerance), PlainSerializer(str)]

WHOLE = SlotConfig(name="whole")
LISTED = SlotConfig(name="face")  # the grid for tasks that need listed poses: the paper's protocol, and sweeps
EXACT = SlotConfig(name="zbuffer")  # the renderer of simulated touches that are independent of the default renderer
OF_WHOLE = {"encoder": SlotConfig(name="pixel", options={"signal": "depth", "cells": 16})}  # for WHOLE


def choose_component(slot: str, grid: str = WHOLE.name) -> SlotConfig:
    """Return the default component of a slot for the grid named `grid`."""
    chosen: SlotConfig = RunConfig.model_fields[slot].default
    return OF_WHOLE.get(slot, chosen) if grid == WHOLE.name else chosen


class RunConfig(StrictModel):
    """All settings that determine a result.

    `shape_px` is the longer image side of the grid's contact shapes, pixels.
    `drop_outliers` leaves out touches that contradict the others.
    `coverage` (0 to 1) returns a set of poses that contains the true pose with this probability.
    `tolerance`, such as "0.5mm,2deg", is the largest error of a pose that counts as right in the verdict.
    `confidence` (0 to 1) is the probability from which such a pose is certain.
    `encoder` has a default that depends on the grid.
    `search`, `hypotheses` and `tracker` hold options to tune: see their classes.
    """

    object: ObjectConfig = ObjectConfig()
    touch: TouchConfig = TouchConfig()
    sensor: SlotConfig = SlotConfig(name="gelslim")
    renderer: SlotConfig = SlotConfig(name="heightmap")
    grid: SlotConfig = WHOLE
    encoder: SlotConfig = SlotConfig(name="pixel")
    matcher: SlotConfig = SlotConfig(name="dense")
    refiner: SlotConfig = SlotConfig(name="joint")
    fuser: SlotConfig = SlotConfig(name="product")
    top: int = Field(default=10, ge=1)
    seed: int = Field(default=0, ge=0)
    shape_px: int = Field(default=64, ge=16, le=1024)
    temperature: float | None = Field(default=None, gt=0)
    coverage: float | None = Field(default=None, gt=0, lt=1)
    tolerance: ToleranceText = ONE_MILLIMETRE
    confidence: float = Field(default=CERTAIN, gt=0, lt=1)
    drop_outliers: bool = False
    search: SearchOptions = SearchOptions()
    hypotheses: HypothesisOptions = HypothesisOptions()
    tracker: TrackerOptions = TrackerOptions()

    @model_validator(mode="before")
    @classmethod
    def _suit_the_grid(cls, value: Any) -> Any:
        """Fill in the defaults that depend on the grid, and take the path of a sensor for the sensor that reads it."""
        if not isinstance(value, dict):
            return value
        if isinstance(value.get("sensor"), str):
            value = value | {"sensor": choose_sensor(value["sensor"])}
        grid = value.get("grid", WHOLE)
        named = grid.get("name") if isinstance(grid, dict) else getattr(grid, "name", grid)
        return {slot: choose_component(slot, str(named)) for slot in OF_WHOLE} | value

    @classmethod
    def from_toml(cls, path: str | Path) -> RunConfig:
        """Read a configuration file. Raises ConfigError when it is missing, is not TOML, or has a wrong entry."""
        return cls.from_dict(read_toml(path), str(path))

    @classmethod
    def from_dict(cls, values: dict[str, Any], source: str = "the configuration") -> RunConfig:
        """Validate nested values. Raises ConfigError, which names `source` and the allowed values, for wrong values."""
        unknown = set(values) - set(cls.model_fields)
        if unknown:
            key = sorted(unknown)[0]
            near = did_you_mean(key, cls.model_fields)
            raise ConfigError(f"{source} has an unknown entry {key!r}.{near} Known: {', '.join(cls.model_fields)}")

        def name_option(key: str) -> str:
            return OPTIONS.get(key, key) if source == COMMAND_LINE else f"{source}: {key}"

        result: RunConfig = validate_options(
            cls, values, "the configuration" if source == COMMAND_LINE else source, name_option
        )
        return result

    def resolve(self) -> dict[str, Any]:
        """Return every setting as JSON values, including the defaults of each component's options.

        Raises ConfigError when a component refuses its options.
        """
        settings = self.model_dump(mode="json")
        for slot in SLOTS:
            chosen = getattr(self, slot)
            options = registry().load(slot, chosen.name).Options
            complete = validate_options(options, chosen.options, f"the {slot} {chosen.name!r}")
            settings[slot] = {"name": chosen.name, "options": complete.model_dump(mode="json")}
        return settings


def find_sensor_kind(name: str) -> str | None:
    """Return the sensor component, "file" or "calibrated", that reads the path `name`; None if `name` is not a path."""
    if name in registry().names("sensor"):
        return None
    if name.endswith(".toml"):
        return "file"
    recover_folder(Path(name))
    return "calibrated" if os.path.isdir(name) or "/" in name else None


def choose_sensor(name: str) -> SlotConfig:
    """Return the sensor with this name, or the one that a .toml file or a calibration folder of this name describes."""
    kind = find_sensor_kind(name)
    return SlotConfig(name=kind, options={"path": name}) if kind else SlotConfig(name=name)


def parse_settings(assignments: Iterable[str]) -> tuple[dict[str, Any], list[str]]:
    """Split words into RunConfig's plain settings, such as "shape_px=32", and the other words.

    Values are read as TOML. A value that is not valid TOML is text.
    """
    plain = RunConfig.model_fields.keys() - {*SLOTS, *TUNABLE, "object", "touch"}
    settings, others = {}, []
    for word in assignments:
        name, equals, text = word.partition("=")
        if equals and name.strip() in plain:
            settings[name.strip()] = parse_value(text.strip())
        else:
            others.append(word)
    return settings, others


def parse_overrides(assignments: Iterable[str], tables: Sequence[str] = SLOTS) -> dict[str, dict[str, Any]]:
    """Convert words such as "slot.option=value" to {slot: {option: value}}.

    Values are read as TOML. A value that is not valid TOML is text. `tables` lists the allowed names before the dot:
    SLOTS, or SLOTS with TUNABLE. Raises ConfigError for words of another form, and for other names.
    """
    overrides: dict[str, dict[str, Any]] = {}
    for word in assignments:
        target, equals, text = word.partition("=")
        slot, dot, option = (part.strip() for part in target.partition("."))
        if not (equals and dot and option):
            raise ConfigError(f"the option {word!r} cannot be read; write SLOT.OPTION=VALUE, such as grid.spacing_mm=3")
        if slot not in tables:
            near = did_you_mean(slot, tables)
            raise ConfigError(f"the option {word!r} names an unknown slot {slot!r}.{near} Known: {', '.join(tables)}")
        overrides.setdefault(slot, {})[option] = parse_value(text.strip())
    return overrides
