"""`tactile-loc library`: build, change, check or list a library of parts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.formatting import format_bytes
from tactile_loc_cli import options
from tactile_loc_cli.console import complain, format_count, make_progress, say, say_table
from tactile_loc_cli.failures import UNEXPECTED, USAGE_ERROR, Finding
from tactile_loc_cli.options import RunOptions, declare
from tactile_loc_cli.workers import Processes, Scheduler, choose_workers

if TYPE_CHECKING:
    from tactile_loc.library.building import Built, RunJobs
    from tactile_loc.library.folder import LibraryFolder

DIRECTIONS = 800

Meshes = Annotated[
    list[Path], typer.Argument(metavar="MESH", help="Mesh files (stl, obj, ply, off, step), or folders of mesh files.")
]
Library = Annotated[Path, typer.Argument(metavar="LIBRARY", help="Folder of the library.")]
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
    options.Takes(
        "units",
        "symmetry",
        units="Unit of the mesh files. Default: auto, guessed from the size of each part.",
        symmetry="Rotational symmetry of every part, such as none or z6. Default: auto, detected for each part.",
    ),
]


application = typer.Typer()


@application.command()
def build(
    meshes: Meshes,
    given: Given,
    out: Out,
    directions: Directions = DIRECTIONS,
    workers: Processes = None,
    scheduler: Scheduler = None,
) -> dict[str, Any]:
    """Build a library that has exactly these parts.

    A part is named like its mesh file. Parts that are in the library already are kept, unless their file or an option
    has changed. After an interruption, the same command continues. If a mesh cannot be used, the other parts are still
    built, and the exit code is 2.
    """
    from tactile_loc.io.config import SlotConfig
    from tactile_loc.library.building import build_library, list_meshes

    chosen = options.make_config(given).object
    sources = list_meshes(meshes, chosen.units, chosen.symmetry)
    grid = SlotConfig(name="whole", options={"directions": directions})
    return _report(build_library(out, sources, grid, _choose_runner(out, workers, scheduler), make_progress()))


@application.command()
def add(
    library: Library, meshes: Meshes, given: Given, workers: Processes = None, scheduler: Scheduler = None
) -> dict[str, Any]:
    """Add parts to a library, or replace parts of the same name.

    The options and the exit code are as for `library build`.
    """
    from tactile_loc.library.building import add_parts, list_meshes

    chosen = options.make_config(given).object
    sources = list_meshes(meshes, chosen.units, chosen.symmetry)
    return _report(add_parts(library, sources, _choose_runner(library, workers, scheduler), make_progress()))


@application.command()
def remove(library: Library, names: Names) -> dict[str, Any]:
    """Remove parts from a library."""
    from tactile_loc.library.folder import LibraryFolder

    left = LibraryFolder.open(library).remove(names)
    say(f"{format_count(len(set(names)), 'part')} removed; {_summarise(left)}")
    return {"library": str(library), "removed": sorted(set(names)), "parts": len(left), "bytes": left.nbytes}


@application.command()
def check(library: Library) -> dict[str, Any]:
    """Verify all checksums of a library, and list the damaged parts and files.

    The exit code is 1 if something is damaged. To repair a part, run `library add` with its mesh.
    """
    from tactile_loc.library.folder import LibraryFolder

    opened = LibraryFolder.open(library)
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
def list_parts(library: Library) -> dict[str, Any]:
    """List the parts of a library, with their sizes in mm."""
    from dataclasses import asdict

    from tactile_loc.library.folder import LibraryFolder

    opened = LibraryFolder.open(library)
    rows = [
        [row.name, f"{row.x_mm:.1f}", f"{row.y_mm:.1f}", f"{row.z_mm:.1f}", str(row.places), row.symmetry, row.source]
        for row in opened.rows.values()
    ]
    say_table([["part", "x mm", "y mm", "z mm", "places", "symmetry", "made from"], *rows], left=(0, 5, 6))
    say(_summarise(opened))
    return {
        "library": str(library),
        "parts": [asdict(row) for row in opened.rows.values()],
        "bytes": opened.nbytes,
        "grid": opened.manifest.grid,
    }


def _choose_runner(library: Path, workers: int | None, scheduler: str | None) -> RunJobs:
    """Return what runs the jobs: this process if one worker is enough, otherwise workers."""
    from tactile_loc.evaluation.workers import count_cores
    from tactile_loc.library.building import WAITING, run_here

    if scheduler is None and (workers or count_cores()) == 1:
        return run_here
    return choose_workers(library / WAITING, workers, scheduler).run_jobs


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


def _summarise(library: LibraryFolder) -> str:
    return f"{format_count(len(library), 'part')}, {format_bytes(library.nbytes)} in {library.path}"
