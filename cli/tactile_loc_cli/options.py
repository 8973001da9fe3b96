"""Options that several commands share, and functions that merge them with a configuration file into a RunConfig."""

from __future__ import annotations

import inspect
import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import ValidationError

from tactile_loc.core.runtime.errors import (
    ConfigError,
    MissingLibraryError,
    OutputError,
    UnknownPluginError,
    advise_choice,
    name_source,
    quote,
)
from tactile_loc.slots.options import validate_options
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc_cli import KINDS_OF_ANNEXES
from tactile_loc_cli.console import complain, is_shown, make_progress

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.core.sensing.touch import Touch
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.localizer import Localizer

logger = logging.getLogger(__name__)


Units = StrEnum("Units", "AUTO M MM CM INCH")  # of a mesh file
TouchUnit = StrEnum("TouchUnit", "M MM UM")
TouchKind = StrEnum("TouchKind", "DISTANCE INDENTATION HEIGHT MASK")
Noise = StrEnum("Noise", "NONE MILD STRONG")  # of simulated touches
TOUCHED = (
    "Mesh file (STL, OBJ, PLY, STEP, ...) or demo object that was touched."  # help of --object where it has no default
)
# Options of RunOptions that many commands take.
OBJECT = ("object", "units", "symmetry")
TOUCH_FILES = ("touch_unit", "touch_kind")
SETTINGS = ("option", "config")
SEARCH = ("grid", "renderer", "encoder", "matcher", "refiner")
OF_FRAMES = (*OBJECT, *TOUCH_FILES, "press_depth", "sensor", "zero", *SEARCH, *SETTINGS, "seed")
READ_FROM = {  # advice for sensors that are chosen by their path
    "file": "give the file itself: --sensor my_sensor.toml",
    "calibrated": "give the calibration folder itself: --sensor FOLDER",
}


def declare(flag: str, about: str, **limits: Any) -> Any:
    """Return the declaration of an option with its help. `flag` also names the value, as in "--out FOLDER".

    A flag without a value, or an option with fixed values, names none.
    """
    name, _, metavar = flag.partition(" ")
    return typer.Option(name, metavar=metavar or None, help=about, **limits)


def set_option(about: str, metavar: str = "SLOT.OPTION=VALUE") -> Any:
    """Return the declaration of `-o SLOT.OPTION=VALUE`, with its help."""
    return typer.Option("-o", "--option", metavar=metavar, help=about)


@dataclass(frozen=True)
class RunOptions:
    """The options that define a run. An option that was not given is None, a flag that was not given False.

    A command takes some of these options through a parameter of this type: see `Takes`.
    """

    object: Annotated[
        str | None, declare("--object FILE|DEMO", "Mesh file (STL, OBJ, PLY, STEP, ...) or demo object. Default: hook.")
    ] = None
    units: Annotated[
        Units | None,
        declare("--units", "Unit of the mesh file. Default: auto, as the file states, else guessed from its size."),
    ] = None
    symmetry: Annotated[
        str | None,
        declare(
            "--symmetry GROUP",
            "Rotational symmetry: none, or terms joined by *. z6: looks the same after each 1/6 turn about z. zinf: "
            "round about z. sphere: round in all directions. Default: auto, detected.",
        ),
    ] = None
    touch: Annotated[
        str | None,
        declare(
            "--touch FILE|FOLDER|LIST",
            "A contact shape (npz, npy, 16-bit png) or an image. A folder or '*.png' locates each touch separately. "
            "A list (.toml) fuses several touches of one object. Default: a simulated touch.",
        ),
    ] = None
    touch_unit: Annotated[
        TouchUnit | None, declare("--touch-unit", "Unit of the touch's depths, if its file does not state it.")
    ] = None
    touch_kind: Annotated[
        TouchKind | None,
        declare(
            "--touch-kind",
            "Meaning of the touch's depths, if its file does not state it: distance from full penetration, indentation "
            "(0 = no contact), or height above the untouched gel. A mask has no depths: 1 or 255 is contact. Default: "
            "distance.",
        ),
    ] = None
    press_depth: Annotated[
        float | None,
        declare("--press-depth MM", "Press depth of the touch in mm. Default: that in its file, or an estimate."),
    ] = None
    noise: Annotated[Noise | None, declare("--noise", "Noise of simulated touches. Default: none.")] = None
    sensor: Annotated[
        str | None,
        declare(
            "--sensor NAME|FILE.toml|FOLDER",
            "Sensor, its description file, or its calibration folder (write ./FOLDER if a sensor has the same name). "
            "Default: gelslim.",
        ),
    ] = None
    zero: Annotated[
        Path | None, declare("--zero IMAGE", "A newer image of the untouched gel, for a calibrated sensor.")
    ] = None
    grid: Annotated[str | None, declare("--grid NAME", "Poses to search. Default: whole.")] = None
    renderer: Annotated[
        str | None, declare("--renderer NAME", "Renderer, which computes contact shapes. Default: heightmap.")
    ] = None
    encoder: Annotated[
        str | None, declare("--encoder NAME", "Encoder, which converts contact shapes to vectors. Default: pixel.")
    ] = None
    matcher: Annotated[
        str | None, declare("--matcher NAME", "Matcher, which compares the vectors. Default: dense.")
    ] = None
    refiner: Annotated[
        str | None, declare("--refiner NAME", "Refiner, which improves the best poses. Default: joint.")
    ] = None
    fuser: Annotated[
        str | None, declare("--fuser NAME", "Fuser, which combines touches and prior. Default: product.")
    ] = None
    option: Annotated[
        list[str] | None,
        set_option(
            "Set an option of a component, such as grid.spacing_mm=3; may be repeated. `plugins SLOT NAME` lists them. "
            "Also sets options of the search, hypotheses and tracker (search.registered=500) and top-level settings "
            "(shape_px=32)."
        ),
    ] = None
    config: Annotated[
        Path | None,
        declare("--config FILE.toml", "Read settings from a TOML file. Options on the command line override it."),
    ] = None
    drop_outliers: Annotated[
        bool, declare("--drop-outliers", "With a list of touches: leave out a touch that contradicts all others.")
    ] = False
    top: Annotated[
        int | None,
        declare(
            "--top N",
            "Number of poses to list. Default: 10. More than 10 also change the probabilities with --grid face or "
            "hopf, and more than 20 with other grids.",
        ),
    ] = None
    coverage: Annotated[
        float | None,
        declare(
            "--coverage P",
            "List the poses of a set that holds the true pose with probability P, such as 0.95; replaces --top.",
        ),
    ] = None
    tolerance: Annotated[
        str | None,
        declare(
            "--tolerance MM,DEG",
            "Largest error of a pose that is called certain: a pose error, a rotation, or both, such as 0.5mm,2deg. "
            "Or shape:1mm for the shape alone, or tip:0.5mm@0,0,30 for a point of the mesh in mm. Default: 1mm.",
        ),
    ] = None
    confidence: Annotated[
        float | None,
        declare("--confidence P", "Probability from which a pose is called certain, such as 0.99. Default: 0.95."),
    ] = None
    seed: Annotated[int | None, declare("--seed N", "Seed of everything random. Default: 0.")] = None


class Takes:
    """Marks a command's parameter of a type such as RunOptions: the names of its options that the command takes.

    Annotated[RunOptions, Takes("object", "seed")] becomes --object and --seed on the command line. Without names, the
    command takes all options. `helps` gives an option a help text for this command alone.
    """

    def __init__(self, *names: str, **helps: str) -> None:
        self.names, self.helps = names, helps

    def choose(self, kind: type) -> tuple[str, ...]:
        """Return the names of the taken options, in the order of the dataclass. Raises ValueError for unknown ones."""
        known = tuple(inspect.signature(kind).parameters)
        if unknown := {*self.names, *self.helps} - {*known}:
            raise ValueError(f"{kind.__name__} has no options {', '.join(sorted(unknown))}; declare them as its fields")
        return tuple(name for name in known if name in self.names) if self.names else known


Rerun = Annotated[
    Path | None, declare("--rerun FILE.rrd", "Also write touches and poses to a file for the Rerun viewer.")
]
Required = StrEnum("Required", "CERTAIN")  # verdicts that --require takes
Require = Annotated[
    Required | None, declare("--require", "End with exit code 3 if the verdict is another one. The result is written.")
]
Report = Annotated[bool, declare("--report", "Also write report.html: the result as one self-contained page.")]
SensorPoses = Annotated[
    Path | None, declare("--poses FILE.csv", "The sensor's poses for a folder of images: a CSV file (docs/files.md).")
]
Store = Annotated[
    Path | None,
    declare("--store FOLDER", "Folder of built models. Default: $TACTILE_LOC_STORE or ~/.cache/tactile-loc."),
]


def make_config(given: RunOptions) -> RunConfig:
    """Merge options with the configuration file that they name, if any. An option overrides the file's setting.

    Raises ConfigError for unknown settings.
    """
    from tactile_loc.io.config import COMMAND_LINE, WHOLE, RunConfig, parse_overrides, parse_settings
    from tactile_loc.io.options import TUNABLE
    from tactile_loc.io.toml import read_toml

    settings = {} if given.config is None else read_toml(given.config)
    tables: dict[str, dict[str, Any]] = {
        "object": {"path": given.object, "units": given.units, "symmetry": given.symmetry},
        "touch": {
            "path": given.touch,
            "unit": given.touch_unit,
            "kind": given.touch_kind,
            "press_depth_mm": given.press_depth,
            "noise": given.noise,
        },
    }
    for name, table in tables.items():
        settings[name] = {**_require_table(settings.get(name, {}), name, given.config), **_drop_none(table)}
    zero = [] if given.zero is None else [f"sensor.zero={json.dumps(str(given.zero))}"]
    plain, words = parse_settings([*(given.option or []), *zero])
    overrides = parse_overrides(words, (*SLOTS, *TUNABLE))
    for name in TUNABLE:
        settings[name] = {**_require_table(settings.get(name, {}), name, given.config), **overrides.get(name, {})}
    grid = WHOLE.name
    for slot in sorted(SLOTS, key=lambda slot: slot != "grid"):  # the other defaults depend on the grid
        in_file = settings.get(slot)
        if not isinstance(in_file, str):
            in_file = _require_table(in_file or {}, slot, given.config)
        settings[slot] = _merge_component(slot, in_file, getattr(given, slot), overrides.get(slot, {}), grid)
        if given.config is not None and in_file:
            _check_component(slot, settings[slot], overrides.get(slot, {}), given.config)
        grid = settings["grid"]["name"]
    if given.zero is not None:
        _require_zero(settings["sensor"]["name"])
    chosen = _drop_none({name: getattr(given, name) for name in ("top", "coverage", "tolerance", "confidence", "seed")})
    own = {**{name: _drop_none(table) for name, table in tables.items()}, **plain, **chosen}
    own |= {name: overrides[name] for name in TUNABLE if name in overrides}
    RunConfig.from_dict(own, COMMAND_LINE)  # raises errors that name the flag, not the file
    settings |= plain | chosen | _drop_none({"drop_outliers": given.drop_outliers or None})
    return RunConfig.from_dict(settings, COMMAND_LINE if given.config is None else str(given.config))


def require_object(settings: RunConfig, touched: str) -> None:
    """Raise ConfigError if touches are given, but not their object. `touched` names the touches: "--touch FILE"."""
    if "path" not in settings.object.model_fields_set:
        raise ConfigError(f"{touched} does not state which object was touched; give --object FILE or a demo object")


def _check_component(slot: str, merged: Mapping[str, Any], overrides: Mapping[str, Any], source: Path) -> None:
    """Raise an error that names the configuration file `source` if it names a wrong component or a wrong option.

    Options in `overrides` are from the command line. The component itself reports errors in them.
    """
    options = {key: value for key, value in merged.items() if key != "name"}
    if not isinstance(merged["name"], str) or isinstance(options.get("options"), dict):
        return
    kind = registry().load(slot, merged["name"]).Options
    try:
        kind(**options)
    except ValidationError as error:
        if next(iter(error.errors()[0]["loc"]), None) not in overrides:
            with name_source(source):
                validate_options(kind, options, f"the {slot} {merged['name']!r}")


def _require_zero(sensor: str) -> None:
    """Raise ConfigError if the sensor of this name cannot take a newer image of the untouched gel."""
    if "zero" not in registry().load("sensor", sensor).Options.model_fields:
        raise ConfigError(
            f"--zero needs a calibrated sensor, but {sensor} is not one; choose --sensor FOLDER, or leave out --zero"
        )


def _drop_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _require_table(value: Any, section: str, source: Path | None) -> dict[str, Any]:
    if not isinstance(value, dict):
        key = "path" if section in ("object", "touch") else "name"
        path = f" with {key} = {json.dumps(value)}" if isinstance(value, str) else ""
        raise ConfigError(f"{source}: {section} cannot be {quote(value)}; give a table [{section}]{path}")
    return value


def _merge_component(
    slot: str, in_file: str | dict[str, Any], flag: str | None, overrides: dict[str, Any], grid: str
) -> dict[str, Any]:
    """Return the name and options of one slot.

    They come from the file, unless the flag names another component. `overrides` replaces single options. If neither
    the file nor the flag names a component, the default component for this `grid` is used.
    """
    from tactile_loc.io.config import choose_component, find_sensor_kind

    given: dict[str, Any] = {"name": in_file} if isinstance(in_file, str) else {**in_file}
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
    merged = {**given, **overrides}
    if slot == "sensor" and merged["name"] in READ_FROM and "path" not in merged:
        raise ConfigError(f"the sensor {merged['name']!r} needs a path; {READ_FROM[merged['name']]}")
    return merged


def _warn_of_namesake(name: str) -> None:
    """Warn if the chosen sensor and a calibration folder have the same name."""
    from tactile_loc.io.sensor_files import is_calibrated_sensor

    if name in registry().names("sensor") and is_calibrated_sensor(Path(name)):
        logger.warning("using the sensor %s, not the calibration folder of this name; for that, write ./%s", name, name)


def open_localizer(config: RunConfig, store: Path | None, obj: ObjectModel | None = None) -> Localizer:
    """Make a localizer, and load the object if it is not given. Raises TactileLocError for bad input."""
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.stored_object import load_stored_object
    from tactile_loc.store.store import StageStore

    kept, chosen = StageStore(store), config.object
    obj = obj or load_stored_object(chosen.path, chosen.units, chosen.symmetry, kept)
    localizer = Localizer(config, obj, kept, make_progress())
    note = localizer.refinement.describe_other_tasks(localizer.sampler.capabilities.places)
    if note and is_shown(logging.WARNING):
        complain("note", note)
    return localizer


def read_touches(localizer: Localizer, path: Path) -> list[tuple[Localizer, Touch]]:
    """Read one touch file or a list of touches, each with its localizer. Raises TactileLocError for bad input."""
    from tactile_loc.locate.touch_files import is_list, read_observations

    if is_list(path):
        return read_observations(localizer, path)
    asked = localizer.config.touch
    return [(localizer, localizer.read_touch(path, asked.unit, asked.press_depth_m, asked.kind))]


def require_slot(slot: str) -> None:
    """Raise UnknownPluginError if there is no slot of this name, and MissingLibraryError if an annex defines it."""
    if slot not in (kinds := registry().kinds):
        if annex := KINDS_OF_ANNEXES.get(slot):
            raise MissingLibraryError(
                f"the slot {slot!r} needs {annex}, which is not installed; in a clone of tactile-loc, run "
                f"pip install ./plugins_contrib/{annex}"
            )
        raise UnknownPluginError(f"there is no slot {slot!r}; {advise_choice(slot, kinds)}")


def require_mcap(flag: str, path: Path) -> None:
    """Raise OutputError if the name of a new recording does not end in .mcap."""
    if path.suffix.lower() != ".mcap":
        raise OutputError(f"{flag} {path.name} must end in .mcap; choose another name")


def require_rerun(path: Path | None) -> None:
    """Raise OutputError or MissingLibraryError if a requested Rerun file cannot be written."""
    if path is not None:
        from tactile_loc.view import rerun_log

        rerun_log.require_rerun(path)
