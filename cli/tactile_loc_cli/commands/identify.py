"""`tactile-loc identify`: which of several objects was touched, if any?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc_cli import options
from tactile_loc_cli.console import progress, say
from tactile_loc_cli.failures import Finding

if TYPE_CHECKING:
    from tactile_loc.core.sensing.touch import Touch
    from tactile_loc.locate.localizer import Localizer

DEFAULT_OUT = Path("tactile-loc-identify")
NONE_OF_THESE = 1

Objects = Annotated[
    Path,
    options.declare("--objects", "FOLDER", "The objects: a folder of mesh files (stl, obj, ply, off)."),
]
Touches = Annotated[
    str, options.declare("--touch", "FILE|LIST", "The touch: a file, or a list (.toml) of several of one object.")
]
Located = Annotated[
    int,
    options.declare("--located", "N", "How many objects to locate, the likeliest of a rough search."),
]
Out = Annotated[Path, options.declare("--out", "FOLDER", "Where identification.json goes.")]


def identify(
    objects: Objects,
    touch: Touches,
    units: options.MeshUnits = None,
    touch_unit: options.TouchUnitOption = None,
    press_depth: options.PressDepth = None,
    sensor: options.Sensor = None,
    option: options.SetOption = None,
    config: options.Config = None,
    located: Located = 8,
    out: Out = DEFAULT_OUT,
    store: options.Store = None,
) -> dict[str, Any]:
    """Tell which of several objects was touched, or that it was none of these, and where it is.

    Each object's model is built the first time and kept. The exit code is 1 if the touches are more probably of none of
    these objects than of any.
    """
    from tactile_loc.store.files import require_writable
    from tactile_loc.store.store import StageStore
    from tactile_loc.tasks.identify import identify as identified
    from tactile_loc.tasks.identify_files import identification_record, read_library, write_identification
    from tactile_loc_cli.results import say_identification

    settings = options.run_config(
        options.RunOptions(
            units=units, touch=touch, touch_unit=touch_unit, press_depth=press_depth, sensor=sensor, option=option,
            config=config,
        )
    )  # fmt: skip
    library = read_library(objects, settings, StageStore(store), progress())
    require_writable(out)
    touches = _read(library.models[0], Path(touch))
    record = identification_record(identified(touches, library, located), [one.name for one in touches])
    say_identification(record)
    written = write_identification(out / "identification.json", record)
    say(f"written: {written}")
    result = {**record.model_dump(mode="json"), "written": [str(written)]}
    if record.identified is None:
        raise Finding(NONE_OF_THESE, result)
    return result


def _read(model: Localizer, path: Path) -> list[Touch]:
    """The touches of a file or a list."""
    from tactile_loc.locate.touch_files import is_list, read_observations

    if is_list(path):
        return [touch for _, touch in read_observations(model, path)]
    return [model.read_touch(path, model.config.touch.unit, options.press_depth_m(model.config))]
