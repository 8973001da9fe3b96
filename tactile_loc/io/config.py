"""The configuration of a run: which object, which touch, which component for each slot, with which options."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from tactile_loc.core.errors import ConfigError, did_you_mean
from tactile_loc.core.sensing.sensor_geometry import Drawing
from tactile_loc.core.simulation.noise import NoiseLevel
from tactile_loc.core.slots.registry import SLOTS, registry, validate_options
from tactile_loc.io.options import TUNABLE, HypothesisOptions, SearchOptions, TrackerOptions
from tactile_loc.io.toml import parse_value, read_toml
from tactile_loc.store.files import recover_folder


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SlotConfig(_Strict):
    """One slot: the component's name and its options. In TOML: a table with `name` and the options beside it."""

    name: str
    options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _unfold(cls, value: Any) -> Any:
        """Accept "icp" and {name = "icp", max_iterations = 30} beside the full form."""
        if isinstance(value, str):
            return {"name": value}
        if isinstance(value, dict) and "options" not in value:
            return {"name": value.get("name"), "options": {k: v for k, v in value.items() if k != "name"}}
        if not isinstance(value, dict | SlotConfig):
            raise PydanticCustomError("slot", "input should be a component's name, or a table of it and its options")
        return value


class ObjectConfig(_Strict):
    """The object: a mesh file or the name of a demo object, its unit, and its symmetry."""

    path: str = "hook"
    units: Literal["m", "mm", "cm", "inch", "auto"] = "auto"
    symmetry: str = "auto"


class TouchConfig(_Strict):
    """The touch: a file, the unit of its depths, and how deep the press was (mm) when the file does not say.

    Without a file a touch is simulated, with `noise`.
    """

    path: str | None = None
    unit: Literal["m", "mm", "um"] | None = None
    press_depth_mm: float | None = None
    noise: NoiseLevel = "none"

    @property
    def press_depth_m(self) -> float | None:
        """How deep the press was, metres; None where the file is to say it."""
        return None if self.press_depth_mm is None else 1e-3 * self.press_depth_mm


WHOLE = SlotConfig(name="whole")
LISTED = SlotConfig(name="face")  # of what needs poses that are listed, as the paper's protocol and sweeps do
OF_WHOLE = {  # what suits the places of a whole object, where nothing is given
    "encoder": SlotConfig(name="pixel", options={"signal": "depth", "cells": 16}),
}


def choose_component(slot: str, grid: str = WHOLE.name) -> SlotConfig:
    """Return what fills a slot that is not given, with a grid of that name, by default the default one."""
    chosen: SlotConfig = RunConfig.model_fields[slot].default
    return OF_WHOLE.get(slot, chosen) if grid == WHOLE.name else chosen


class RunConfig(_Strict):
    """Everything that decides a result. `shape_px` is the longer image side of the grid's contact shapes, pixels.

    `together` refines against several touches: "joint" all at once, "each" by what the refiner makes of each touch.
    `drop_outliers` leaves out those of several touches that contradict the others.
    `coverage` asks for all modes of a set of poses that holds the true one with that probability, 0 to 1.
    An `encoder` that is not given suits the grid: of a whole object, pixel with its options.
    `search`, `hypotheses` and `tracker` are numbers to tune: see their classes.
    `drawing` is what touches are compared with: the object "pressed", as the sensor sees it, or where it just touches,
    as in the "paper".
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
    together: Literal["joint", "each"] = "joint"
    coverage: float | None = Field(default=None, gt=0, lt=1)
    drawing: Drawing = "pressed"
    drop_outliers: bool = False
    search: SearchOptions = SearchOptions()
    hypotheses: HypothesisOptions = HypothesisOptions()
    tracker: TrackerOptions = TrackerOptions()

    @model_validator(mode="before")
    @classmethod
    def _suit_the_grid(cls, value: Any) -> Any:
        """What is not given is what suits the grid."""
        if not isinstance(value, dict):
            return value
        grid = value.get("grid", WHOLE)
        named = grid.get("name") if isinstance(grid, dict) else getattr(grid, "name", grid)
        return {slot: choose_component(slot, str(named)) for slot in OF_WHOLE} | value

    @classmethod
    def from_toml(cls, path: str | Path) -> RunConfig:
        """Read a configuration file. Raises ConfigError when it is missing, no TOML, or has unknown entries."""
        return cls.from_dict(read_toml(path), str(path))

    @classmethod
    def from_dict(cls, values: dict[str, Any], source: str = "the configuration") -> RunConfig:
        """Validate nested values; raises ConfigError in one sentence that names `source` and what is allowed."""
        unknown = set(values) - set(cls.model_fields)
        if unknown:
            key = sorted(unknown)[0]
            near = did_you_mean(key, cls.model_fields)
            raise ConfigError(f"{source} has an unknown entry {key!r}.{near} Known: {', '.join(cls.model_fields)}")
        result: RunConfig = validate_options(cls, values, f"configuration {source!r}")
        return result

    def resolve(self) -> dict[str, Any]:
        """Return every setting as JSON values, each component's options complete with their defaults.

        Raises ConfigError when a component refuses its options.
        """
        settings = self.model_dump(mode="json")
        for slot in SLOTS:
            chosen = getattr(self, slot)
            options = registry().load(slot, chosen.name).Options
            complete = validate_options(options, chosen.options, f"{slot} {chosen.name!r}")
            settings[slot] = {"name": chosen.name, "options": complete.model_dump(mode="json")}
        return settings


def find_sensor_kind(name: str) -> str | None:
    """Return the component that reads a sensor given by its path; None when it is the name of one."""
    if name in registry().names("sensor"):
        return None
    if name.endswith(".toml"):
        return "file"
    recover_folder(Path(name))
    return "calibrated" if os.path.isdir(name) or "/" in name else None


def parse_settings(assignments: Iterable[str]) -> tuple[dict[str, Any], list[str]]:
    """Split words into the values of RunConfig's plain settings, as "drawing=paper", and the other words.

    Values are read as TOML, else as text.
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
    """Turn "slot.option=value" words into {slot: {option: value}}; values are read as TOML, else as text.

    `tables` are the slots, and perhaps TUNABLE. Raises ConfigError for words of another form or an unknown slot.
    """
    overrides: dict[str, dict[str, Any]] = {}
    for word in assignments:
        target, equals, text = word.partition("=")
        slot, dot, option = (part.strip() for part in target.partition("."))
        if not (equals and dot and option):
            raise ConfigError(f"cannot read the option {word!r}; write it as slot.option=value, as grid.spacing_mm=3")
        if slot not in tables:
            raise ConfigError(
                f"there is no slot {slot!r} in {word!r}.{did_you_mean(slot, tables)} Slots: {', '.join(tables)}"
            )
        overrides.setdefault(slot, {})[option] = parse_value(text.strip())
    return overrides
