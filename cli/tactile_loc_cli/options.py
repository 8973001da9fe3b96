"""The options that several commands share, and how they become a RunConfig together with a configuration file."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.slots.registry import SLOTS

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.localizer import Localizer


logger = logging.getLogger(__name__)


class Units(StrEnum):
    """Units of a mesh file."""

    AUTO = "auto"
    M = "m"
    MM = "mm"
    CM = "cm"
    INCH = "inch"


class TouchUnit(StrEnum):
    """Units of a touch file."""

    M = "m"
    MM = "mm"
    UM = "um"


class Noise(StrEnum):
    """Noise of simulated touches."""

    NONE = "none"
    MILD = "mild"
    STRONG = "strong"


def declare(flag: str, metavar: str | None, about: str, **limits: Any) -> Any:
    """Return the declaration of an option that takes one value a time, with its help."""
    return typer.Option(flag, metavar=metavar, help=about, **limits)


def set_option(about: str, metavar: str = "SLOT.OPTION=VALUE") -> Any:
    """Return the declaration of `-o SLOT.OPTION=VALUE`, with its help."""
    return typer.Option("-o", "--option", metavar=metavar, help=about)


Object = Annotated[
    str | None,
    declare("--object", "FILE|DEMO", "Mesh file (STL, OBJ, PLY, ...) or the name of a demo object; by default hook."),
]
MeshUnits = Annotated[
    Units | None, typer.Option("--units", help="Unit of the mesh file; by default auto, a guess from its size.")
]
Symmetry = Annotated[
    str | None,
    declare("--symmetry", "GROUP", "Rotations onto itself: none, z2, z6*x2, zinf, ...; by default auto finds them."),
]
Sensor = Annotated[
    str | None,
    declare(
        "--sensor",
        "NAME|FILE.toml|FOLDER",
        "A sensor, its description, or its calibration's folder (./NAME if it is called as a sensor is); by default "
        "gelslim.",
    ),
]
Grid = Annotated[str | None, declare("--grid", "NAME", "Which poses are searched; by default whole.")]
Renderer = Annotated[str | None, declare("--renderer", "NAME", "What renders contact shapes; by default heightmap.")]
Encoder = Annotated[str | None, declare("--encoder", "NAME", "What makes vectors of them; by default pixel.")]
Matcher = Annotated[str | None, declare("--matcher", "NAME", "What compares the vectors; by default dense.")]
Refiner = Annotated[
    str | None,
    declare("--refiner", "NAME", "What refines the best poses; by default joint."),
]
Fuser = Annotated[str | None, declare("--fuser", "NAME", "What combines touches and prior; by default product.")]
SetOption = Annotated[
    list[str] | None,
    set_option(
        "A component's option, as grid.spacing_mm=3; may be repeated; `plugins SLOT NAME` lists them. Or a plain "
        "setting of the configuration, as drawing=paper."
    ),
]
Config = Annotated[
    Path | None,
    declare("--config", "FILE.toml", "Settings from a TOML file; options on the command line override it."),
]
TouchUnitOption = Annotated[
    TouchUnit | None,
    typer.Option("--touch-unit", help="Unit of the touch's depths, if its file does not say."),
]
PressDepth = Annotated[
    float | None,
    declare("--press-depth", "MM", "How deep the press was, in mm; by default as the file says, or the deepest."),
]
TouchNoise = Annotated[
    Noise | None,
    typer.Option("--noise", help="How far simulated touches are from clean renders; by default none."),
]
Seed = Annotated[int | None, declare("--seed", "N", "Seed of everything random; by default 0.")]
Zero = Annotated[
    Path | None,
    typer.Option("--zero", metavar="IMAGE", help="A newer image of the calibrated sensor's untouched gel."),
]
Rerun = Annotated[
    Path | None,
    declare("--rerun", "FILE.rrd", "Write touches and poses as a file for the Rerun viewer, too; none is started."),
]
Store = Annotated[
    Path | None,
    declare("--store", "FOLDER", "Where models are kept; by default $TACTILE_LOC_STORE or ~/.cache/tactile-loc."),
]


@dataclass(frozen=True)
class RunOptions:
    """The options of a command that decide a run, as they were given; None where they were not."""

    object: str | None = None
    units: Units | None = None
    symmetry: str | None = None
    touch: str | None = None
    touch_unit: TouchUnit | None = None
    press_depth: float | None = None
    noise: str | None = None
    sensor: str | None = None
    grid: str | None = None
    renderer: str | None = None
    encoder: str | None = None
    matcher: str | None = None
    refiner: str | None = None
    fuser: str | None = None
    option: Sequence[str] | None = None
    config: Path | None = None
    top: int | None = None
    coverage: float | None = None
    seed: int | None = None
    drop_outliers: bool = False


def run_config(given: RunOptions) -> RunConfig:
    """Merge options over the configuration file that they name, if any. Raises ConfigError for unknown settings."""
    from tactile_loc.io.config import WHOLE, RunConfig, parse_overrides, parse_settings
    from tactile_loc.io.options import TUNABLE
    from tactile_loc.io.toml import read_toml

    settings = {} if given.config is None else read_toml(given.config)
    tables: dict[str, dict[str, Any]] = {
        "object": {"path": given.object, "units": given.units, "symmetry": given.symmetry},
        "touch": {"path": given.touch, "unit": given.touch_unit, "press_depth_mm": given.press_depth,
                  "noise": given.noise},
    }  # fmt: skip
    for name, table in tables.items():
        settings[name] = {**_table(settings.get(name, {}), name), **_without_none(table)}
    plain, words = parse_settings(given.option or [])
    overrides = parse_overrides(words, (*SLOTS, *TUNABLE))
    for name in TUNABLE:
        settings[name] = {**_table(settings.get(name, {}), name), **overrides.get(name, {})}
    grid = WHOLE.name
    for slot in sorted(SLOTS, key=lambda slot: slot != "grid"):  # what suits it is known then
        settings[slot] = _component(slot, settings.get(slot), getattr(given, slot), overrides.get(slot, {}), grid)
        grid = settings["grid"]["name"]
    chosen = {"top": given.top, "coverage": given.coverage, "seed": given.seed}
    settings |= plain | _without_none({**chosen, "drop_outliers": given.drop_outliers or None})
    return RunConfig.from_dict(settings, "the command line" if given.config is None else str(given.config))


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _table(value: Any, section: str) -> dict[str, Any]:
    from tactile_loc.core.errors import ConfigError

    if not isinstance(value, dict):
        raise ConfigError(
            f"the configuration's {section} is {value!r}; it must be a table, as [{section}] with path = ..."
        )
    return value


def _component(slot: str, in_file: Any, flag: str | None, overrides: dict[str, Any], grid: str) -> Any:
    """Return one slot's name and options: the file's, unless the flag names another component; `overrides` on top.

    What neither gives is the default with the `grid` of that name.
    """
    from tactile_loc.io.config import default_component, kind_of_sensor

    given: dict[str, Any] = {"name": in_file} if isinstance(in_file, str) else dict(_table(in_file or {}, slot))
    given |= given.pop("options", {}) if isinstance(given.get("options"), dict) else {}
    if "name" not in given and flag is None:
        default = default_component(slot, grid)
        given = {"name": default.name, **default.options, **given}
    if slot == "sensor" and flag is not None:
        _warn_of_namesake(flag)
    if flag is not None and flag != given.get("name", flag):
        given = {}
    if flag is not None:
        given["name"] = flag
    if slot == "sensor" and (kind := kind_of_sensor(str(given["name"]))):
        given = {**given, "name": kind, "path": given["name"]}
    return {**given, **overrides}


def _warn_of_namesake(name: str) -> None:
    """Say so when a sensor is chosen whose name a calibration's folder bears, too."""
    from tactile_loc.core.slots.registry import registry
    from tactile_loc.io.sensor_files import is_calibrated_sensor

    if name in registry().names("sensor") and is_calibrated_sensor(Path(name)):
        logger.warning("the sensor %s is used, not what is in the folder of this name: for that write ./%s", name, name)


def open_localizer(config: RunConfig, store: Path | None, obj: ObjectModel | None = None) -> Localizer:
    """Make a localizer of the object, which is loaded if it is not given. Raises TactileLocError for bad input."""
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.stored_object import stored_object
    from tactile_loc.store.store import StageStore
    from tactile_loc_cli.console import progress

    kept, chosen = StageStore(store), config.object
    obj = obj or stored_object(chosen.path, chosen.units, chosen.symmetry, kept)
    return Localizer(config, obj, kept, progress())


def load_object(config: RunConfig) -> ObjectModel:
    """Load the configuration's object. Raises ObjectError or SymmetryError."""
    from tactile_loc.io.meshes import load_object as load

    return load(config.object.path, config.object.units, config.object.symmetry)


def press_depth_m(config: RunConfig) -> float | None:
    """Return the press depth that was asked for, metres."""
    asked_mm = config.touch.press_depth_mm
    return None if asked_mm is None else 1e-3 * asked_mm


def with_zero(option: list[str] | None, zero: Path | None) -> list[str] | None:
    """Return components' options with that of a newer image of the untouched gel, if there is one."""
    return option if zero is None else [*(option or []), f"sensor.zero={json.dumps(str(zero))}"]


def require_rerun(path: Path | None) -> None:
    """Check that a Rerun file can be written, if one is asked for. Raises OutputError or MissingLibraryError."""
    if path is not None:
        from tactile_loc.drawing import rerun_log

        rerun_log.require_rerun(path)
