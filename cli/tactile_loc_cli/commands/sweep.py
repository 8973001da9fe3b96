"""`tactile-loc sweep`: every combination of components, on every object."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc_cli import options, sweep_results
from tactile_loc_cli.console import complain, progress
from tactile_loc_cli.failures import UNEXPECTED, Finding
from tactile_loc_cli.options import declare, set_option

if TYPE_CHECKING:
    from tactile_loc.sweeps.plan import Plan
    from tactile_loc.sweeps.sweep import Sweep, Workers

DEFAULT_OUT = Path("sweep")


PlanFile = Annotated[
    Path | None, typer.Argument(metavar="PLAN.toml", help="The plan; options on the command line override it.")
]
Objects = Annotated[
    list[str] | None,
    declare("--object", "FILE|DEMO,...", "Mesh files or demo objects; by default all demo objects."),
]
Sensors = Annotated[list[str] | None, declare("--sensor", "NAME|PATH,...", "Sensors; by default gelslim.")]
Renderers = Annotated[list[str] | None, declare("--renderer", "NAME,...", "Renderers; by default heightmap.")]
Grids = Annotated[list[str] | None, declare("--grid", "NAME,...", "Grids; by default face.")]
Encoders = Annotated[list[str] | None, declare("--encoder", "NAME,...", "Encoders; by default pixel.")]
Matchers = Annotated[list[str] | None, declare("--matcher", "NAME,...", "Matchers; by default dense.")]
Refiners = Annotated[list[str] | None, declare("--refiner", "NAME,...", "Refiners; by default joint.")]
Fusers = Annotated[list[str] | None, declare("--fuser", "NAME,...", "Fusers; by default product.")]
Noises = Annotated[
    list[str] | None, declare("--noise", "NAME,...", "Noises of the touches: none, mild, strong; by default strong.")
]
Seeds = Annotated[list[str] | None, declare("--seed", "N,...", "Seeds of the touches; by default 0.")]
Options = Annotated[
    list[str] | None,
    set_option(
        "Values of an option, as grid.spacing_mm=3,4; they go to the components that have it; may be repeated.",
        "SLOT.OPTION=VALUE,...",
    ),
]
Count = Annotated[
    int | None, declare("--count", "N", "Simulated touches a combination; by default 150.", min=1, max=100_000)
]
Line = Annotated[
    str, declare("--line", "LINE", "Whose errors sweep.md, pictures and comparisons show: best-1, reg-1, chosen, ...")
]
Processes = Annotated[int | None, declare("--workers", "N", "Local processes; by default one a core.", min=1)]
Threads = Annotated[
    int | None, declare("--threads", "N", "Threads of each local process (OpenMP, numba); by default 1.", min=1)
]
Scheduler = Annotated[
    str | None, declare("--scheduler", "tcp://HOST:PORT", "Run on the workers of this Dask scheduler instead.")
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="List the combinations and count the stages to be built; run nothing.")
]
Compare = Annotated[
    Path | None, declare("--compare", "FOLDER", "Compare --out with this older sweep; without a plan, only compare.")
]
Out = Annotated[Path, declare("--out", "FOLDER", "Where the rows, tables and pictures go.")]
Store = Annotated[
    Path | None,
    declare(
        "--store", "FOLDER", "Where models are kept, the same folder for all workers; by default as for other commands."
    ),
]


def sweep(
    plan: PlanFile = None,
    object: Objects = None,
    units: options.MeshUnits = None,
    symmetry: options.Symmetry = None,
    sensor: Sensors = None,
    renderer: Renderers = None,
    grid: Grids = None,
    encoder: Encoders = None,
    matcher: Matchers = None,
    refiner: Refiners = None,
    fuser: Fusers = None,
    noise: Noises = None,
    seed: Seeds = None,
    option: Options = None,
    count: Count = None,
    line: Line = "chosen",
    workers: Processes = None,
    threads: Threads = None,
    scheduler: Scheduler = None,
    dry_run: DryRun = False,
    compare: Compare = None,
    out: Out = DEFAULT_OUT,
    store: Store = None,
) -> dict[str, Any]:
    """Evaluate every combination of components.

    Options with "..." take several values, separated by commas or by repeating them; all combinations of all values are
    evaluated, as in docs/sweeps.md, on local processes or a Dask cluster. A combination that fails is a row with its
    error, and the exit code is then 1. Interrupted, the same command resumes.
    """
    from tactile_loc.sweeps.results import require_line

    planned = {
        "object": object, "sensor": sensor, "renderer": renderer, "grid": grid, "encoder": encoder, "matcher": matcher,
        "refiner": refiner, "fuser": fuser, "noise": noise, "seed": seed, "count": count, "option": option,
    }  # fmt: skip
    given = {key: value for key, value in planned.items() if value is not None}

    require_line(line)
    if plan is None and not given:
        return sweep_results.compare_with(compare, out, line)
    wanted = _plan(plan, given, units, symmetry)
    place = _store(store)
    if dry_run:
        return sweep_results.dry_run(wanted, out, place)
    if compare is not None:
        sweep_results.require_sweep(compare)
    found = _run(wanted, out, place, _workers(workers, threads, scheduler, out))
    report = sweep_results.report(found, out, line)
    if compare is not None:
        report["comparison"] = sweep_results.compare_with(compare, out, line)
    if found.failed:
        complain(
            "failed", f"{found.failed} of {len(found.combinations)} combinations; the errors are in {out}/sweep.md"
        )
        raise Finding(UNEXPECTED, report)
    return report


def _plan(path: Path | None, given: dict[str, Any], units: options.Units | None, symmetry: str | None) -> Plan:
    """The file's plan with what is given on the command line over it."""
    from tactile_loc.core.errors import ConfigError
    from tactile_loc.io.toml import read_toml
    from tactile_loc.sweeps.plan import Plan, merge_options, read_options, split_all

    source = "the command line" if path is None else str(path)
    in_file = {} if path is None else read_toml(path)
    values = {**in_file, **{key: value if key == "count" else split_all(value) for key, value in given.items()}}
    if "option" in given:
        written = read_options(in_file.get("option", []), source)
        values["option"] = merge_options(written, read_options(given["option"], "the command line"))
    table = {"units": units, "symmetry": symmetry}
    table = {key: str(value) for key, value in table.items() if value is not None}
    if table:
        objects = values.get("object", [])
        objects = objects if isinstance(objects, list) else [objects]
        if not objects or ("symmetry" in table and len(objects) > 1):
            raise ConfigError(
                "--units and --symmetry need --object, and --symmetry is of one object; give them in a plan"
            )
        values["object"] = [{**(one if isinstance(one, dict) else {"path": one}), **table} for one in objects]
    return Plan.from_values(values, source)


def _store(store: Path | None) -> Path:
    from tactile_loc.store.store import StageStore

    return StageStore(store).root


def _workers(workers: int | None, threads: int | None, scheduler: str | None, out: Path) -> Workers:
    from tactile_loc.core.errors import ConfigError
    from tactile_loc.sweeps.workers import DaskWorkers, LocalWorkers, count_cores

    if scheduler is None:
        return LocalWorkers(workers or count_cores(), threads or 1, out / "workers.log")
    if workers is not None or threads is not None:
        raise ConfigError(
            "--workers and --threads are of local processes; with --scheduler the cluster decides, see docs/sweeps.md"
        )
    return DaskWorkers(scheduler)


def _run(plan: Plan, out: Path, store: Path, workers: Workers) -> Sweep:
    from tactile_loc.sweeps.sweep import run_sweep

    return run_sweep(plan, out, store, workers, progress())
