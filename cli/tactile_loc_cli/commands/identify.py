"""`tactile-loc identify`: find which of several objects was touched, if any."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.console import make_progress, say_written
from tactile_loc_cli.failures import NOT_AS_REQUIRED, Finding
from tactile_loc_cli.options import RunOptions

DEFAULT_OUT = Path("tactile-loc-identify")
NONE_OF_THESE = 1

Objects = Annotated[
    Path,
    options.declare("--objects", "FOLDER", "Folder of mesh files (stl, obj, ply, off, step), or a library of parts."),
]
Touches = Annotated[
    str, options.declare("--touch", "FILE|LIST", "A touch file, or a list (.toml) of several touches of one object.")
]
Located = Annotated[
    int, options.declare("--located", "N", "Number of objects to locate: the most probable ones after a rough search.")
]
Out = Annotated[Path, options.declare("--out", "FOLDER", "Folder of identification.json.")]
Given = Annotated[
    RunOptions,
    options.Takes(
        "units",
        "symmetry",
        "touch_unit",
        "touch_kind",
        "press_depth",
        "sensor",
        "option",
        "config",
        symmetry="Rotational symmetry of every object, such as none or z6. Default: auto, detected for each object.",
    ),
]


def identify(
    objects: Objects,
    touch: Touches,
    given: Given,
    located: Located = 8,
    out: Out = DEFAULT_OUT,
    report: options.Report = False,
    require: options.Require = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Find which of several objects was touched.

    The command also locates this object. Each object's model is built once and stored. The first line states the
    verdict and the probable objects. The exit code is 1 if "none of these" is most probable.
    """
    from tactile_loc.io.streams.records import write_record
    from tactile_loc.store.store import StageStore
    from tactile_loc.tasks.identify import identify as identify_touches
    from tactile_loc.tasks.identify_files import make_identification_record, read_library
    from tactile_loc_cli.results import say_identification

    settings = options.make_config(replace(given, touch=touch))
    library = read_library(objects, settings, StageStore(store), make_progress())
    require_writable(out)
    touches = [one for _, one in options.read_touches(library.models[0], Path(touch))]
    record = make_identification_record(identify_touches(touches, library, located), [one.name for one in touches])
    say_identification(record)
    files = [write_record(out / "identification.json", record)]
    if report:
        from tactile_loc.reports.report import DEFAULT_NAME, write_page
        from tactile_loc.reports.tasks import make_identification_page

        files.append(write_page(make_identification_page(record, touches), out / DEFAULT_NAME))
    written = say_written(files)
    result = {**record.model_dump(mode="json"), "written": written}
    if require is not None and result["verdict"] != require:
        raise Finding(NOT_AS_REQUIRED, result)
    if record.identified is None:
        raise Finding(NONE_OF_THESE, result)
    return result
