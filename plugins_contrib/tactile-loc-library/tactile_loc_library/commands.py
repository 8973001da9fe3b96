"""`tactile-loc library`: build, change, check or list a library of parts, or identify one of its parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from tactile_loc.commands import (
    UNEXPECTED,
    USAGE_ERROR,
    Finding,
    IdentificationOutput,
    RunOptions,
    Store,
    Takes,
    WorkerOptions,
    complain,
    declare,
    format_bytes,
    format_count,
    make_config,
    make_progress,
    read_touches,
    say,
    say_table,
)

if TYPE_CHECKING:
    from tactile_loc_library.building import Built, RunJobs
    from tactile_loc_library.library import Library

DIRECTIONS, LOCATED, UNKNOWN = 800, 12, 0.2

Meshes = Annotated[
    list[Path], typer.Argument(metavar="MESH", help="Mesh files (stl, obj, ply, off, step), or folders of mesh files.")
]
Folder = Annotated[Path, typer.Argument(metavar="LIBRARY", help="Folder of the library.")]
Names = Annotated[list[str], typer.Argument(metavar="NAME", help="Names of parts.")]
Out = Annotated[Path, declare("--out LIBRARY", "Folder of the library.")]
Directions = Annotated[
    int,
    declare(
        "--directions N",
        "Directions from which the places of a part are found; fewer give a smaller library.",
        min=100,
        max=100_000,
    ),
]
Given = Annotated[
    RunOptions,
    Takes(
        "units",
        "symmetry",
        units="Unit of the mesh files. Default: auto, guessed from the size of each part.",
        symmetry="Rotational symmetry of every part, such as none or z6. Default: auto, detected for each part.",
    ),
]


Touches = Annotated[str, declare("--touch FILE|LIST", "A touch file, or a list (.toml) of touches of one part.")]
Located = Annotated[int, declare("--located N", "Most parts to locate: the most probable ones after a rough search.")]
Unknown = Annotated[
    float, declare("--unknown SHARE", "Share of touched objects that are no part, before any touch: above 0, below 1.")
]
Workers = Annotated[WorkerOptions, Takes("workers", "scheduler")]
GivenTouch = Annotated[
    RunOptions, Takes("touch_unit", "touch_kind", "press_depth", "sensor", "zero", "option", "config")
]

application = typer.Typer()


@application.command()
def build(
    meshes: Meshes, given: Given, out: Out, workers: Workers, directions: Directions = DIRECTIONS
) -> dict[str, Any]:
    """Build a library that has exactly these parts.

    A part is named like its mesh file. Parts that are in the library already are kept, unless their file or an option
    has changed. After an interruption, the same command continues. If a mesh cannot be used, the other parts are still
    built, and the exit code is 2.
    """
    from tactile_loc_library.building import build_library, list_meshes
    from tactile_loc_library.record import PlaceGrid

    chosen = make_config(given).object
    sources = list_meshes(meshes, chosen.units, chosen.symmetry)
    grid = PlaceGrid("whole", {"directions": directions})
    return _report(build_library(out, sources, grid, _choose_runner(out, workers), make_progress()))


@application.command()
def add(library: Folder, meshes: Meshes, given: Given, workers: Workers) -> dict[str, Any]:
    """Add parts to a library, or replace parts of the same name.

    The options and the exit code are as for `library build`.
    """
    from tactile_loc_library.building import add_parts, list_meshes

    chosen = make_config(given).object
    sources = list_meshes(meshes, chosen.units, chosen.symmetry)
    return _report(add_parts(library, sources, _choose_runner(library, workers), make_progress()))


@application.command()
def remove(library: Folder, names: Names) -> dict[str, Any]:
    """Remove parts from a library."""
    from tactile_loc_library.library import Library

    left = Library.open(library).remove(names)
    say(f"{format_count(len(set(names)), 'part')} removed; {_summarise(left)}")
    return {"library": str(library), "removed": sorted(set(names)), "parts": len(left), "bytes": left.nbytes}


@application.command()
def check(library: Folder) -> dict[str, Any]:
    """Verify all checksums of a library, and list the damaged parts and files.

    The exit code is 1 if something is damaged. To repair a part, run `library add` with its mesh.
    """
    from tactile_loc_library.library import Library

    opened = Library.open(library)
    with make_progress().task("verifying checksums", len(opened.shards)) as advance:
        damage = opened.find_damage(advance)
    for name in damage.parts:
        say(f"damaged part: {name}")
    for name, reason in damage.files.items():
        say(f"damaged file: {name}: {reason}")
    if not damage:
        say(f"all checksums match: {_summarise(opened)}")
    result = {"library": str(library), "parts": len(opened), "damaged": list(damage.parts), "files": dict(damage.files)}
    if damage:
        raise Finding(UNEXPECTED, result)
    return result


@application.command("list")
def list_parts(library: Folder) -> dict[str, Any]:
    """List the parts of a library, with their sizes in mm."""
    from dataclasses import asdict

    from tactile_loc_library.library import Library

    opened = Library.open(library)
    rows = [
        [row.name, f"{row.x_mm:.1f}", f"{row.y_mm:.1f}", f"{row.z_mm:.1f}", str(row.places), row.symmetry, row.source]
        for row in opened.rows.values()
    ]
    say_table([["part", "x mm", "y mm", "z mm", "places", "symmetry", "made from"], *rows], left=(0, 5, 6))
    say(_summarise(opened))
    parts = [asdict(row) for row in opened.rows.values()]
    return {"library": str(library), "parts": parts, "bytes": opened.nbytes, "grid": opened.manifest.grid}


@application.command()
def identify(
    library: Folder,
    touch: Touches,
    given: GivenTouch,
    located: Located = LOCATED,
    unknown: Unknown = UNKNOWN,
    *,
    output: IdentificationOutput,
    store: Store = None,
) -> dict[str, Any]:
    """Find which part of a library was touched.

    The command also locates this part. The first line states the verdict and the probable parts. With --around or
    --candidates, the command also ranks the approaches that best separate the possible parts and their poses. The exit
    code is 1 if "none of these" is most probable.
    """
    from tactile_loc import NullEvidence, StageStore

    from tactile_loc_library.identification import identify_part
    from tactile_loc_library.library import Library
    from tactile_loc_library.search import PartSearch

    null = NullEvidence(unknown)
    settings = make_config(replace(given, touch=touch))
    search = PartSearch(Library.open(library), settings, StageStore(store), make_progress())
    with search.use(0) as part:
        touches = [one for _, one in read_touches(part.model, Path(touch))]
    return output.conclude(identify_part(touches, search, located, null), touches)


def _choose_runner(library: Path, workers: WorkerOptions) -> RunJobs:
    """Return what runs the jobs: this process if one worker is enough, otherwise other processes."""
    from tactile_loc_library.building import WAITING, run_here

    return run_here if workers == WorkerOptions(workers=1) else workers.choose(library / WAITING).run_jobs


def _report(built: Built) -> dict[str, Any]:
    """Show and return what was built. Raises Finding if a part failed."""
    for name, reason in built.failed.items():
        complain("failed", f"{name}: {reason}")
    say(f"{format_count(len(built.made), 'part')} built, {len(built.kept)} kept; {_summarise(built.library)}")
    result = {
        "library": str(built.library.path),
        "built": list(built.made),
        "kept": list(built.kept),
        "failed": dict(built.failed),
        "parts": len(built.library),
        "bytes": built.library.nbytes,
    }
    if built.failed:
        raise Finding(USAGE_ERROR, result)
    return result


def _summarise(library: Library) -> str:
    return f"{format_count(len(library), 'part')}, {format_bytes(library.nbytes)} in {library.path}"
