"""`tactile-loc sweep`: evaluate every combination of components on every object."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.slots.registry import SLOTS
from tactile_loc_cli import options
from tactile_loc_cli.console import complain, format_count, make_progress, say, say_table, say_written
from tactile_loc_cli.failures import UNEXPECTED, Finding
from tactile_loc_cli.options import declare, set_option
from tactile_loc_cli.workers import WorkerOptions

if TYPE_CHECKING:
    from tactile_loc.evaluation.sweep.plan import Plan
    from tactile_loc.evaluation.sweep.sweep import Sweep

DEFAULT_OUT = Path("sweep")
MOST_SHOWN = 40  # lines of a table

PlanFile = Annotated[
    Path | None, typer.Argument(metavar="PLAN.toml", help="The plan; options on the command line override it.")
]
Line = Annotated[str, declare("--line LINE", "Error to show in sweep.md: best-1, reg-1, ... (docs/evaluation.md).")]
DryRun = Annotated[bool, declare("--dry-run", "List the combinations without running them.")]
Out = Annotated[Path, declare("--out FOLDER", "Folder of the rows and tables.")]


@dataclass(frozen=True)
class Choices:
    """The values that are combined: the options that override a plan."""

    object: Annotated[
        list[str] | None, declare("--object FILE|DEMO,...", "Mesh files or demo objects. Default: all demo objects.")
    ] = None
    sensor: Annotated[list[str] | None, declare("--sensor NAME|PATH,...", "Sensors. Default: gelslim.")] = None
    renderer: Annotated[list[str] | None, declare("--renderer NAME,...", "Renderers. Default: heightmap.")] = None
    grid: Annotated[list[str] | None, declare("--grid NAME,...", "Grids that list their poses. Default: face.")] = None
    encoder: Annotated[list[str] | None, declare("--encoder NAME,...", "Encoders. Default: pixel.")] = None
    matcher: Annotated[list[str] | None, declare("--matcher NAME,...", "Matchers. Default: dense.")] = None
    refiner: Annotated[list[str] | None, declare("--refiner NAME,...", "Refiners. Default: joint.")] = None
    fuser: Annotated[list[str] | None, declare("--fuser NAME,...", "Fusers. Default: product.")] = None
    noise: Annotated[
        list[str] | None, declare("--noise NAME,...", "Noises of the touches: none, mild, strong. Default: strong.")
    ] = None
    seed: Annotated[list[str] | None, declare("--seed N,...", "Seeds of the touches. Default: 0.")] = None
    option: Annotated[
        list[str] | None,
        set_option(
            "Values of an option, such as grid.spacing_mm=3,4, for the components that have it; may be repeated.",
            "SLOT.OPTION=VALUE,...",
        ),
    ] = None
    count: Annotated[
        int | None, declare("--count N", "Simulated touches for each combination. Default: 150.", min=1, max=100_000)
    ] = None


def sweep(
    plan: PlanFile = None,
    *,
    choices: Choices,
    given: Annotated[options.RunOptions, options.Takes("units", "symmetry")],
    line: Line = "chosen",
    workers: WorkerOptions,
    dry_run: DryRun = False,
    out: Out = DEFAULT_OUT,
    store: options.Store = None,
) -> dict[str, Any]:
    """Evaluate every combination of components.

    Options with "..." take several values, separated by commas or given by repeated options. All combinations of the
    values are evaluated in local processes or on a Dask cluster (docs/sweeps.md). All workers share one store. If a
    combination fails, its row holds the error, and the exit code is 1. After an interruption, the same command resumes.
    """
    from tactile_loc.evaluation.sweep.sweep import run_sweep
    from tactile_loc.evaluation.sweep.tables import require_line
    from tactile_loc.store.store import StageStore

    values = {key: value for key, value in vars(choices).items() if value is not None}
    require_line(line)
    if plan is None and not values:
        raise ConfigError("no plan is given; give a plan file, or options such as --refiner none,icp")
    wanted = _make_plan(plan, values, given.units, given.symmetry)
    place = StageStore(store).root
    if dry_run:
        return _list_combinations(wanted, out)
    found = run_sweep(wanted, out, place, workers.choose(out), make_progress())
    report = _report(found, out, line)
    if found.failed:
        complain(
            "failed", f"{found.failed} of {len(found.combinations)} combinations; their errors are in {out}/sweep.md"
        )
        raise Finding(UNEXPECTED, report)
    return report


def _make_plan(path: Path | None, given: dict[str, Any], units: options.Units | None, symmetry: str | None) -> Plan:
    """Return the plan in the file, with the settings from the command line."""
    from tactile_loc.evaluation.sweep.plan import Plan, merge_options, read_options, split_all
    from tactile_loc.io.config import COMMAND_LINE
    from tactile_loc.io.toml import read_toml

    source = COMMAND_LINE if path is None else str(path)
    in_file = {} if path is None else read_toml(path)
    values = {**in_file, **{key: value if key == "count" else split_all(value) for key, value in given.items()}}
    if "option" in given:
        written = read_options(in_file.get("option", []), source)
        values["option"] = merge_options(written, read_options(given["option"], COMMAND_LINE))
    if path is not None:
        _check_given(given, values)
    table = {"units": units, "symmetry": symmetry}
    table = {key: str(value) for key, value in table.items() if value is not None}
    if table:
        objects = values.get("object", [])
        objects = objects if isinstance(objects, list) else [objects]
        if not objects or ("symmetry" in table and len(objects) > 1):
            flag, needed = ("--symmetry", "a single --object") if "symmetry" in table else ("--units", "--object")
            raise ConfigError(f"{flag} needs {needed}; give it, or write the {flag[2:]} in the plan")
        values["object"] = [{**(one if isinstance(one, dict) else {"path": one}), **table} for one in objects]
    return Plan.from_values(values, source)


def _check_given(given: dict[str, Any], values: dict[str, Any]) -> None:
    """Raise the errors of the command line before those of the plan's file, whose name they must not have."""
    from tactile_loc.evaluation.sweep.plan import Plan, read_options
    from tactile_loc.io.config import COMMAND_LINE

    written, merged = (read_options(one.get("option", []), COMMAND_LINE) for one in (given, values))
    slots = [slot for slot in SLOTS if slot in given or slot in written]
    own = {key: values[key] for key in (*given, *slots) if key != "option" and key in values}
    Plan.from_values({**own, "option": {slot: merged[slot] for slot in slots if slot in merged}}, COMMAND_LINE)


def _list_combinations(plan: Plan, out: Path) -> dict[str, Any]:
    """List the combinations and which of them are done, and return both."""
    from tactile_loc.evaluation.jobs import FinishedJobs
    from tactile_loc.evaluation.sweep.combination import combine
    from tactile_loc.evaluation.sweep.plan import name_choices

    combinations, _ = combine(plan)
    done = FinishedJobs(out).find_successful(one.key for one in combinations)
    labels = name_choices(plan)
    rows = [
        [
            one.object,
            *(labels[slot][i] for slot, i in zip(SLOTS, one.place[1:-2], strict=True)),
            one.config.touch.noise,
            str(one.config.seed),
            "done" if one.key in done else "to do",
        ]
        for one in combinations
    ]
    header = ["object", *SLOTS, "noise", "seed", "state"]
    say_table([header, *rows], left=len(header))
    say()
    missing = len(combinations) - len(done)
    say(f"{format_count(len(combinations), 'combination')} with {plan.count} touches each, {missing} to do")
    keys = [dict(zip(header, row, strict=True)) for row in rows]
    return {"combinations": keys, "count": plan.count, "missing": missing}


def _report(found: Sweep, out: Path, line: str) -> dict[str, Any]:
    """Write the results of a sweep, show them, and return a summary."""
    from tactile_loc.evaluation.sweep.tables import write_sweep

    files = write_sweep(out, found, line)
    _say_medians(found, line)
    total, done, evaluated = len(found.combinations), len(found.done), found.evaluated
    counts = f"{evaluated} evaluated now, {done - evaluated} from the store, {total - done} from {out}"
    say()
    say(f"{format_count(total, 'combination')}: {counts}")
    built = found.built_now
    say(f"stages built now: {', '.join(f'{stage} {count}' for stage, count in built.items()) or 'none'}")
    return {
        "out": str(out),
        "combinations": total,
        "evaluated": evaluated,
        "stored": done - evaluated,
        "failed": found.failed,
        "built": built,
        "line": line,
        "written": say_written(files),
    }


def _say_medians(found: Sweep, line: str) -> None:
    """Show the median errors, best first."""
    from tactile_loc.evaluation.sweep.tables import tabulate_medians

    medians = found.compute_medians(line)
    for noise in found.plan.noises:
        header, *rows = tabulate_medians(medians, noise, lambda error, _: f"{error.value:.3g}")
        say(f"median error in mm (line {line}, noise {noise})")
        say_table([header, *rows[:MOST_SHOWN]], left=1)
        if len(rows) > MOST_SHOWN:
            say(f"{len(rows) - MOST_SHOWN} more rows are in sweep.md")
