"""The options that several commands share, and how they become a RunConfig together with a configuration file."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.slots.registry import SLOTS, registry
from tactile_loc_cli.console import complain, is_shown, make_progress

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.localizer import Localizer, Observation

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
    """Return the declaration of an option with its help; a flag, or an option of few values, has no `metavar`."""
    return typer.Option(flag, metavar=metavar, help=about, **limits)


def set_option(about: str, metavar: str = "SLOT.OPTION=VALUE") -> Any:
    """Return the declaration of `-o SLOT.OPTION=VALUE`, with its help."""
    return typer.Option("-o", "--option", metavar=metavar, help=about)


@dataclass(frozen=True)
class RunOptions:
    """The options that decide a run, each with its declaration; None where it was not given.

    A command takes some of them by a parameter of this type: see `takes`.
    """

    object: Annotated[
        str | None,
        declare(
            "--object", "FILE|DEMO", "Mesh file (STL, OBJ, PLY, ...) or the name of a demo object; by default hook."
        ),
    ] = None
    units: Annotated[
        Units | None, declare("--units", None, "Unit of the mesh file; by default auto, a guess from its size.")
    ] = None
    symmetry: Annotated[
        str | None,
        declare(
            "--symmetry", "GROUP", "Rotations onto itself: none, z2, z6*x2, zinf, ...; by default auto finds them."
        ),
    ] = None
    touch: Annotated[
        str | None,
        declare(
            "--touch", "FILE|FOLDER|LIST",
            "The touch: a contact shape (npz, npy, 16-bit png), an image; a folder or '*.png' for many, each for "
            "itself; a list (.toml) for several of one object, fused; by default simulated.",
        ),
    ] = None  # fmt: skip
    touch_unit: Annotated[
        TouchUnit | None, declare("--touch-unit", None, "Unit of the touch's depths, if its file does not say.")
    ] = None
    press_depth: Annotated[
        float | None,
        declare("--press-depth", "MM", "How deep the press was, in mm; by default as the file says, or the deepest."),
    ] = None
    noise: Annotated[
        Noise | None, declare("--noise", None, "How far simulated touches are from clean renders; by default none.")
    ] = None
    sensor: Annotated[
        str | None,
        declare(
            "--sensor", "NAME|FILE.toml|FOLDER",
            "A sensor, its description, or its calibration's folder (./NAME if it is called as a sensor is); by "
            "default gelslim.",
        ),
    ] = None  # fmt: skip
    zero: Annotated[
        Path | None, declare("--zero", "IMAGE", "A newer image of the calibrated sensor's untouched gel.")
    ] = None
    grid: Annotated[str | None, declare("--grid", "NAME", "Which poses are searched; by default whole.")] = None
    renderer: Annotated[
        str | None, declare("--renderer", "NAME", "What renders contact shapes; by default heightmap.")
    ] = None
    encoder: Annotated[str | None, declare("--encoder", "NAME", "What makes vectors of them; by default pixel.")] = None
    matcher: Annotated[str | None, declare("--matcher", "NAME", "What compares the vectors; by default dense.")] = None
    refiner: Annotated[str | None, declare("--refiner", "NAME", "What refines the best poses; by default joint.")] = (
        None
    )
    fuser: Annotated[str | None, declare("--fuser", "NAME", "What combines touches and prior; by default product.")] = (
        None
    )
    option: Annotated[
        list[str] | None,
        set_option(
            "A component's option, as grid.spacing_mm=3; may be repeated; `plugins SLOT NAME` lists them. Or a number "
            "to tune, of search, hypotheses or tracker, as search.registered=500. Or a plain setting, as drawing=paper."
        ),
    ] = None
    config: Annotated[
        Path | None,
        declare("--config", "FILE.toml", "Settings from a TOML file; options on the command line override it."),
    ] = None
    drop_outliers: Annotated[
        bool,
        declare("--drop-outliers", None, "With a list of touches: leave out those that contradict all others."),
    ] = False
    top: Annotated[int | None, declare("--top", "N", "How many poses to list; by default 10.")] = None
    coverage: Annotated[
        float | None,
        declare(
            "--coverage", "P",
            "List all modes of a set of poses that holds the true one with this probability, as 0.95.",
        ),
    ] = None  # fmt: skip
    seed: Annotated[int | None, declare("--seed", "N", "Seed of everything random; by default 0.")] = None


@dataclass(frozen=True)
class Takes:
    """The names of the options that a command takes, in the order of RunOptions."""

    names: tuple[str, ...]


def takes(*names: str) -> Takes:
    """Return what marks a command's parameter of type RunOptions; without names it takes all options.

    Annotated[RunOptions, takes("object", "seed")] becomes --object and --seed on the command line.
    """
    known = tuple(field.name for field in fields(RunOptions))
    if unknown := set(names) - {*known}:
        raise ValueError(f"there are no options {', '.join(sorted(unknown))}; declare them as fields of RunOptions")
    return Takes(tuple(name for name in known if name in names) if names else known)


Rerun = Annotated[
    Path | None,
    declare("--rerun", "FILE.rrd", "Write touches and poses as a file for the Rerun viewer, too; none is started."),
]
Store = Annotated[
    Path | None,
    declare("--store", "FOLDER", "Where models are kept; by default $TACTILE_LOC_STORE or ~/.cache/tactile-loc."),
]


def make_config(given: RunOptions) -> RunConfig:
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
        settings[name] = {**_require_table(settings.get(name, {}), name), **_drop_none(table)}
    zero = [] if given.zero is None else [f"sensor.zero={json.dumps(str(given.zero))}"]
    plain, words = parse_settings([*(given.option or []), *zero])
    overrides = parse_overrides(words, (*SLOTS, *TUNABLE))
    for name in TUNABLE:
        settings[name] = {**_require_table(settings.get(name, {}), name), **overrides.get(name, {})}
    grid = WHOLE.name
    for slot in sorted(SLOTS, key=lambda slot: slot != "grid"):  # what suits it is known then
        settings[slot] = _merge_component(slot, settings.get(slot), getattr(given, slot), overrides.get(slot, {}), grid)
        grid = settings["grid"]["name"]
    chosen = {"top": given.top, "coverage": given.coverage, "seed": given.seed}
    settings |= plain | _drop_none({**chosen, "drop_outliers": given.drop_outliers or None})
    return RunConfig.from_dict(settings, "the command line" if given.config is None else str(given.config))


def _drop_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _require_table(value: Any, section: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(
            f"the configuration's {section} is {value!r}; it must be a table, as [{section}] with path = ..."
        )
    return value


def _merge_component(slot: str, in_file: Any, flag: str | None, overrides: dict[str, Any], grid: str) -> Any:
    """Return one slot's name and options: the file's, unless the flag names another component; `overrides` on top.

    What neither gives is the default with the `grid` of that name.
    """
    from tactile_loc.io.config import choose_component, find_sensor_kind

    given: dict[str, Any] = {"name": in_file} if isinstance(in_file, str) else {**_require_table(in_file or {}, slot)}
    given |= given.pop("options", {}) if isinstance(given.get("options"), dict) else {}
    if "name" not in given and flag is None:
        default = choose_component(slot, grid)
        given = {"name": default.name, **default.options, **given}
    if slot == "sensor" and flag is not None:
        _warn_of_namesake(flag)
    if flag is not None and flag != given.get("name", flag):
        given = {}
    if flag is not None:
        given["name"] = flag
    if slot == "sensor" and (kind := find_sensor_kind(str(given["name"]))):
        given = {**given, "name": kind, "path": given["name"]}
    return {**given, **overrides}


def _warn_of_namesake(name: str) -> None:
    """Say so when a sensor is chosen whose name a calibration's folder bears, too."""
    from tactile_loc.io.sensor_files import is_calibrated_sensor

    if name in registry().names("sensor") and is_calibrated_sensor(Path(name)):
        logger.warning("the sensor %s is used, not what is in the folder of this name: for that write ./%s", name, name)


def open_localizer(config: RunConfig, store: Path | None, obj: ObjectModel | None = None) -> Localizer:
    """Make a localizer of the object, which is loaded if it is not given. Raises TactileLocError for bad input."""
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.stored_object import load_stored_object
    from tactile_loc.store.store import StageStore

    kept, chosen = StageStore(store), config.object
    obj = obj or load_stored_object(chosen.path, chosen.units, chosen.symmetry, kept)
    localizer = Localizer(config, obj, kept, make_progress())
    if localizer.other_refinement and is_shown(logging.WARNING):
        complain("note", localizer.other_refinement)
    return localizer


def read_touches(localizer: Localizer, path: Path) -> list[Observation]:
    """Read the touch of a file, or all of a list, each with its localizer. Raises TactileLocError for bad input."""
    from tactile_loc.locate.touch_files import is_list, read_observations

    if is_list(path):
        return read_observations(localizer, path)
    asked = localizer.config.touch
    return [(localizer, localizer.read_touch(path, asked.unit, asked.press_depth_m))]


def require_rerun(path: Path | None) -> None:
    """Check that a Rerun file can be written, if one is asked for. Raises OutputError or MissingLibraryError."""
    if path is not None:
        from tactile_loc.drawing import rerun_log

        rerun_log.require_rerun(path)
