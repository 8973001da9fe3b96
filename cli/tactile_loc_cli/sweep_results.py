"""What `tactile-loc sweep` shows: combinations before they run, results after, and two sweeps side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.slots.registry import SLOTS
from tactile_loc_cli.console import say, say_table

if TYPE_CHECKING:
    from tactile_loc.sweeps.plan import Plan
    from tactile_loc.sweeps.sweep import Sweep

MOST_SHOWN = 40  # lines of a list of combinations


def dry_run(plan: Plan, out: Path, store: Path) -> dict[str, Any]:
    """List what would be done, and return it."""
    from tactile_loc.sweeps.combination import combine, find_missing_stages
    from tactile_loc.sweeps.plan import name_choices
    from tactile_loc.sweeps.sweep import FinishedRows, find_finished

    combinations, objects = combine(plan)
    done = find_finished(combinations, FinishedRows(out))
    missing = [one for one in combinations if one.key not in done]
    stages = find_missing_stages(missing, objects, store)
    labels = name_choices(plan)
    rows = [
        [one.object, *(labels[slot][i] for slot, i in zip(SLOTS, one.place[1:-2], strict=True)), one.config.touch.noise,
         str(one.config.seed), "done" if one.key in done else "to do"]
        for one in combinations
    ]  # fmt: skip
    header = ["object", *SLOTS, "noise", "seed", ""]
    say_table([header, *rows], left=len(header))
    say(f"\n{len(combinations)} combinations of {plan.count} touches each, {len(missing)} to do")
    say(f"stages to be built: {', '.join(f'{stage} {count}' for stage, count in stages.items())}")
    say("of encoders that follow the press depth, one bank is counted; they need one for each depth of the touches")
    keys = [dict(zip([*header[:-1], "state"], row, strict=True)) for row in rows]
    return {"combinations": keys, "count": plan.count, "missing": len(missing), "stages_to_build": stages}


def report(found: Sweep, out: Path, line: str) -> dict[str, Any]:
    """Write the results of a sweep, show them, and return what was written."""
    from tactile_loc.sweeps.results import write_sweep

    written = [str(path) for path in write_sweep(out, found, line)]
    _say_pivot(found, line)
    total = len(found.combinations)
    say(f"\n{total} combinations: {found.done} evaluated now, {total - found.done} before")
    say(f"stages built: {', '.join(f'{stage} {count}' for stage, count in found.built.items()) or 'none'}")
    say(f"written: {', '.join(written)}")
    return {
        "out": str(out), "combinations": total, "evaluated": found.done, "failed": found.failed, "built": found.built,
        "line": line, "written": written,
    }  # fmt: skip


def _say_pivot(found: Sweep, line: str) -> None:
    """Show the median errors, best first."""
    from tactile_loc.sweeps.results import FAILED, pivot

    medians = found.compute_medians(line)
    for noise in found.plan.noises:
        errors_mm = pivot(medians, noise)
        rows = [
            [str(label), *(FAILED if value != value else f"{value:.3g}" for value in row)]
            for label, row in zip(errors_mm.index, errors_mm.to_numpy(), strict=True)
        ]
        say(f"median error of {line}, mm, noise {noise}")
        say_table([["components", *errors_mm.columns], *rows[:MOST_SHOWN]], left=1)
        if len(rows) > MOST_SHOWN:
            say(f"... and {len(rows) - MOST_SHOWN} more, in sweep.md")


def require_sweep(folder: Path) -> None:
    """Raise ConfigError unless the folder holds a sweep's results."""
    from tactile_loc.sweeps.results import read_sweep

    read_sweep(folder)


def compare_with(old: Path | None, new: Path, line: str) -> dict[str, Any]:
    """Compare two finished sweeps, show what changed, and return it. Raises ConfigError."""
    from tactile_loc.core.errors import ConfigError
    from tactile_loc.sweeps.comparison import compare, format_texts, summarise, write_comparison
    from tactile_loc.sweeps.results import read_sweep

    if old is None:
        raise ConfigError("there is nothing to sweep; give a plan (sweep.toml), or options such as --refiner none,icp")
    comparison = compare(read_sweep(old), read_sweep(new), line)
    table = format_texts(comparison)
    written = [str(path) for path in write_comparison(new, comparison)]
    changed = table[table["change"] != ""].to_numpy().tolist()
    if changed:
        say_table([list(table.columns), *changed[:MOST_SHOWN]], left=len(table.columns) - 4)
    say(summarise(comparison))
    for name, (before, after) in comparison.versions.items():
        say(f"{name}: {before} -> {after}")
    say(f"written: {', '.join(written)}")
    marks = {mark: comparison.count(mark) for mark in sorted({*table["change"]} - {""})}
    return {
        "combinations": len(table),
        "line": line,
        "changes": marks,
        "versions": comparison.versions,
        "written": written,
    }
