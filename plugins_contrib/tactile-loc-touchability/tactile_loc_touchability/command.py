"""`tactile-loc touchability`: predict whether touch determines the pose of a part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from tactile_loc.commands import (
    Obstacles,
    RunOptions,
    Store,
    Takes,
    WorkerOptions,
    declare,
    format_mm,
    make_config,
    make_progress,
    open_localizer,
    say,
    say_table,
    say_written,
)
from tactile_loc.plugin import ConfigError

from tactile_loc_touchability.words import write_place, write_share

if TYPE_CHECKING:
    from tactile_loc_touchability.details import Findings
    from tactile_loc_touchability.study import SensorSetup, Study

NOISE = "mild"  # of the touches, if none is given
DEFAULT_OUT, PAGE = Path("touchability"), "report.html"
SAID = {"certain": "certain", "right": "within 1 mm"}

Part = Annotated[
    str, typer.Argument(metavar="PART", help="Mesh file (STL, OBJ, PLY, STEP, ...) or demo object.", show_default=False)
]
Sensors = Annotated[
    list[str] | None,
    declare(
        "--sensor NAME|FILE.toml|FOLDER",
        "Sensor, its description file, or its calibration folder; repeat it to compare sensors. Default: gelslim.",
    ),
]
PressDepths = Annotated[
    list[float] | None,
    declare("--press-depth MM", "Depth of the presses; repeat it to compare. Default: 60 % of the sensor's deepest."),
]
Touches = Annotated[int, declare("--touches N", "Simulated touches, for each sensor and press.", min=20)]
Sets = Annotated[int, declare("--sets N", "Simulated sets of two touches, and of three, each located together.", min=0)]
Tilt = Annotated[
    float, declare("--tilt DEG", "Largest angle between a press and the surface's normal.", min=0.0, max=80.0)
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of touchability.json, report.html, and rows to resume from.")]
Given = Annotated[
    RunOptions,
    Takes(
        "units",
        "symmetry",
        "grid",
        "renderer",
        "encoder",
        "matcher",
        "refiner",
        "option",
        "seed",
        "noise",
        noise=f"Noise of the touches. Default: {NOISE}.",
    ),
]
Body = Annotated[Obstacles, Takes("finger")]
Workers = Annotated[WorkerOptions, Takes("workers", "threads")]


def touchability(
    part: Part,
    *,
    given: Given,
    obstacles: Body,
    sensor: Sensors = None,
    press_depth: PressDepths = None,
    touches: Touches = 400,
    sets: Sets = 40,
    tilt: Tilt = 30.0,
    workers: Workers,
    out: Out = DEFAULT_OUT,
    store: Store = None,
) -> dict[str, Any]:
    """Predict whether touch determines the pose of a part.

    Touches at random places of the part are simulated and located as `run` does. The result states how often one touch,
    two or three end certain, and where. After an interruption, the same command resumes.
    """
    import numpy as np
    from tactile_loc import write_page

    from tactile_loc_touchability.details import find_details, give_answer
    from tactile_loc_touchability.files import write_document
    from tactile_loc_touchability.page import make_touchability_page
    from tactile_loc_touchability.study import StudyOptions, run_studies

    progress = make_progress()
    setups = list_setups(part, given, sensor, press_depth, obstacles, store)
    renderer = setups[0].localizer.config.renderer.name
    options = StudyOptions(touches, sets, float(np.radians(tilt)), given.noise or NOISE, renderer, given.seed or 0)
    studies = run_studies(setups, options, out, workers.choose(out), progress)
    say_studies(studies)
    found = find_details(studies, out, workers.choose(out), progress)
    answer = give_answer(found)
    say_findings(found, answer)
    document, path = write_document(studies, found, answer, out)
    page = write_page(make_touchability_page(studies, found, answer), out / PAGE)
    return {**document, "written": say_written([path, page])}


def list_setups(
    part: str,
    given: RunOptions,
    sensors: list[str] | None,
    presses_mm: list[float] | None,
    obstacles: Obstacles,
    store: Path | None,
) -> list[SensorSetup]:
    """Return each sensor with each press. Raises ConfigError for an impossible press."""
    from tactile_loc_touchability.study import PRESS_SHARE, SensorSetup

    setups: list[SensorSetup] = []
    names: list[str | None] = [*sensors] if sensors else [None]
    for name in names:
        config = make_config(replace(given, object=part, sensor=name, noise=None))
        localizer = open_localizer(config, store, setups[0].localizer.object if setups else None)
        clearance = obstacles.find_clearance(localizer.scene.geometry, in_base=True)
        deepest_mm = 1e3 * localizer.scene.geometry.max_depth_m
        for press_mm in presses_mm or [PRESS_SHARE * deepest_mm]:
            if not 0 < press_mm <= deepest_mm:
                raise ConfigError(
                    f"the sensor {config.sensor.name} cannot be pressed {press_mm:g} mm deep; give `press_depth` more "
                    f"than 0 and at most {deepest_mm:.3g}"
                )
            setups.append(SensorSetup(localizer, 1e-3 * press_mm, clearance))
    return setups


def say_studies(studies: list[Study]) -> None:
    """Write the shares of each sensor and press."""
    obj = studies[0].localizer.object
    size = " x ".join(format_mm(side) for side in obj.mesh.extents_m)
    say(f"{obj.name}: {size} mm, symmetry {obj.symmetry}")
    rows = [["sensor, press", "touches", "simulated", "certain", "within 1 mm", "certain but wrong", "no feature"]]
    for study in studies:
        for one in study.list_shares():
            shares = (write_share(one[name]) for name in ("certain", "right", "wrong", "nothing"))
            rows.append([study.name, str(one["touches"]), str(one["sets"]), *shares])
    say_table(rows, left=1)


def say_findings(found: Findings, answer: str) -> None:
    """Write the best touches, the confused pairs and the best feature."""
    say(f"details: {found.study.name}")
    for one in found.best:
        places = ", ".join(write_place(found.study.presses.places_m[k]) for k in one.presses)
        shares = " and ".join(f"{write_share(one.shares[name])} {word}" for name, word in SAID.items())
        say(f"best {len(one.presses)}: {places} mm: {shares}")
    for number, pair in enumerate(found.pairs, 1):
        say(f"pair {number}: {pair.describe()}")
    say(found.features[0].describe() if found.features else found.no_feature)
    say(answer)
