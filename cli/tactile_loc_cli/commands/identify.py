"""`tactile-loc identify`: find which of several objects was touched, if any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.commands.next_touch import DRAWN, SEED, Around, Candidates, find_approaches
from tactile_loc_cli.console import make_progress, say_written
from tactile_loc_cli.failures import NOT_AS_REQUIRED, Finding
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from tactile_loc.core.sensing.touch import Touch
    from tactile_loc.io.approach_files import Approach
    from tactile_loc.planning.next_touch import NextTouch
    from tactile_loc.tasks.identify import Identification

DEFAULT_OUT = Path("tactile-loc-identify")
NONE_OF_THESE = 1

Objects = Annotated[
    Path, declare("--objects FOLDER", "Folder of mesh files (stl, obj, step, glb, ...), or a library of parts.")
]
Touches = Annotated[
    str, declare("--touch FILE|LIST", "A touch file, or a list (.toml) of several touches of one object.")
]
Located = Annotated[int, declare("--located N", "Most objects to locate: the most probable ones after a rough search.")]
Unknown = Annotated[
    float,
    declare("--unknown SHARE", "Share of touched objects that are none of these, before any touch: above 0, below 1."),
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of identification.json.")]
Given = Annotated[
    RunOptions,
    options.Takes(
        "units",
        "symmetry",
        *options.TOUCH_FILES,
        "press_depth",
        "sensor",
        *options.SETTINGS,
        symmetry="Rotational symmetry of every object, such as none or z6. Default: auto, detected for each object.",
    ),
]


def identify(
    objects: Objects,
    touch: Touches,
    given: Given,
    located: Located = 12,
    unknown: Unknown = 0.2,
    candidates: Candidates = None,
    around: Around = None,
    out: Out = DEFAULT_OUT,
    report: options.Report = False,
    require: options.Require = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Find which of several objects was touched.

    The command also locates this object. Each object's model is built once and stored. The first line states the
    verdict and the probable objects. With --around or --candidates, the command also ranks the approaches that best
    separate the possible objects and their poses. The exit code is 1 if "none of these" is most probable.
    """
    from tactile_loc.io.approach_files import write_approaches
    from tactile_loc.io.streams.records import write_record
    from tactile_loc.store.store import StageStore
    from tactile_loc.tasks.identify import identify as identify_touches
    from tactile_loc.tasks.identify_files import make_identification_record, read_library
    from tactile_loc.tasks.null_evidence import NullEvidence
    from tactile_loc_cli.results import say_identification

    null = NullEvidence(unknown)
    settings = options.make_config(replace(given, touch=touch))
    library = read_library(objects, settings, StageStore(store), make_progress())
    require_writable(out)
    touches = [one for _, one in options.read_touches(library.models[0], Path(touch))]
    found = identify_touches(touches, library, located, null)
    approaches, chosen = _rate_approaches(found, touches, candidates, around)
    record = make_identification_record(found, [one.name for one in touches], chosen)
    say_identification(record, chosen)
    files = [write_record(out / "identification.json", record)]
    if around is not None and approaches:
        files.append(write_approaches(out / DRAWN, approaches, touches[0].T_base_sensor is not None))
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


def _rate_approaches(
    found: Identification, touches: Sequence[Touch], candidates: Path | None, around: int | None
) -> tuple[Sequence[Approach], NextTouch | None]:
    """Return the approaches and their ratings; none if none were asked for, or if no object is probable."""
    from tactile_loc.planning.next_touch import choose_next_touch

    if (candidates is None and around is None) or (modes := found.modes) is None:
        return [], None
    T_base_sensor = touches[0].T_base_sensor
    approaches = find_approaches(candidates, around, SEED, modes, T_base_sensor, None)
    return approaches, choose_next_touch(modes, approaches)
