"""A sweep: it evaluates the missing combinations, keeps every finished row, and writes the tables of all rows.

The tables are sweep.csv, .parquet, .md and .json. Other commands read sweep.json.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tactile_loc.core.runtime.errors import ConfigError, advise_choice
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.evaluation.jobs import JobOutcome, QueuedJob, Workers, resume_jobs
from tactile_loc.evaluation.protocol import LINES, PROTOCOL_VERSION
from tactile_loc.evaluation.sweep.combination import (
    COVERAGES,
    ERRORS,
    IDS,
    TIMES,
    Combination,
    CombinationJob,
    combine,
    name_time,
    order_for_running,
)
from tactile_loc.evaluation.sweep.plan import Plan, find_varied_options, find_varying_slots, name_choices
from tactile_loc.evaluation.text_tables import (
    Row,
    Table,
    build_document,
    format_csv,
    format_document,
    pivot,
    require_parquet,
    write_parquet,
    write_texts,
)
from tactile_loc.slots.registry import SLOTS
from tactile_loc.store.files import read_json, require_writable

SCHEMA_VERSION = 1
FAILED = "failed"
EVALUATION = "evaluation"  # the stage of a combination's results

IDENTITY = ("object", *SLOTS, "noise", "seed", "count")
MOMENTARY = (*TIMES, "model_s", "built")
"""The columns that depend on the machine or the moment; all others are the same wherever a plan is run."""
MEASURED = (*ERRORS, *COVERAGES, "nll_nats", *TIMES, "model_s")
NAMED = ("encoder", "refiner")  # the slots that labels name if no slot varies


class ChoiceMedian(NamedTuple):
    """The median error, mm, and time per touch, ms, of one object, noise and choice of components, as means over seeds.

    Error and time are of the same line of the protocol.

    Both are NaN if a combination failed. `choices` has the index of each slot's choice in the plan. `label` names the
    choices of slots that vary.
    """

    object: str
    noise: str
    choices: tuple[int, ...]
    label: str
    error_mm: float
    time_ms: float


@dataclass(frozen=True, eq=False)
class Sweep:
    """A plan's combinations and their outcomes.

    `done` has the keys of the combinations whose rows this call made; the other rows were there before.
    """

    plan: Plan
    combinations: Sequence[Combination]
    outcomes: Mapping[str, JobOutcome]
    done: Sequence[str]

    @cached_property
    def rows(self) -> list[Row]:
        """A row of JSON values for each combination."""
        return make_rows(self.plan, self.combinations, self.outcomes)

    def compute_medians(self, line: str) -> list[ChoiceMedian]:
        """Return the median error of `line` for each object, noise and choice of components, in the plan's order."""
        labels, named = name_choices(self.plan), find_varying_slots(self.plan) or NAMED
        found: dict[tuple[Any, ...], list[list[float]]] = {}
        for one, row in zip(self.combinations, self.rows, strict=True):
            values = (row[f"{line}_median_mm"], row[name_time(line)])
            key = one.object, one.config.touch.noise, one.place[1:-2]
            found.setdefault(key, []).append([math.nan if value is None else value for value in values])
        return [
            ChoiceMedian(
                name,
                noise,
                choices,
                " + ".join(labels[slot][k] for slot, k in zip(SLOTS, choices, strict=True) if slot in named),
                *np.mean(values, axis=0).tolist(),
            )
            for (name, noise, choices), values in found.items()
        ]

    def find_changed(self) -> dict[str, tuple[str, ...]]:
        """Return the slots that by their nature change more than the method: each with "grid", "touches", or both.

        Rows that differ in such a slot are not equal in all else.
        """
        found = {}
        for slot in find_varying_slots(self.plan):
            place = 1 + SLOTS.index(slot)
            groups: dict[Any, list[Row]] = {}
            for one, row in zip(self.combinations, self.rows, strict=True):
                groups.setdefault((*one.place[:place], *one.place[place + 1 :]), []).append(row)
            changed = (
                name for name in IDS if any(len({r[name] for r in rows} - {None}) > 1 for rows in groups.values())
            )
            if names := tuple(name.removesuffix("_id") for name in changed):
                found[slot] = names
        return found

    @property
    def failed(self) -> int:
        """The number of combinations that ended with an error."""
        return sum(bool(outcome.error) for outcome in self.outcomes.values())

    @property
    def evaluated(self) -> int:
        """The number of combinations whose evaluation was built or failed in this call; others are in the store."""
        outcomes = (self.outcomes[key] for key in self.done)
        return sum(bool(one.error) or any(name.split()[0] == EVALUATION for name in one.built) for one in outcomes)

    @property
    def built(self) -> dict[str, int]:
        """The number of artifacts of each stage that the sweep has built."""
        stages = Counter(name.split()[0] for outcome in self.outcomes.values() for name in outcome.built)
        return dict(sorted(stages.items()))


def run_sweep(plan: Plan, out: Path, store: Path, workers: Workers, progress: Progress | None = None) -> Sweep:
    """Evaluate every combination of `plan` that has no row in `out`; write each row there when it is finished.

    The row of a failed combination states the error, and the next call tries the combination again. All workers share
    the stage store in the folder `store`. Raises TactileLocError for a bad plan or `out`, before anything runs.
    """
    require_parquet("a sweep")
    combinations, objects = combine(plan)
    require_writable(out)
    queue = [
        QueuedJob(
            CombinationJob(one.key, one.config, one.count, store),
            objects[one.object],
            f"{one.object} {one.config.encoder.name} {one.config.refiner.name}",
            {"object": one.object, "configuration": one.describe()},
        )
        for one in order_for_running(combinations)
    ]
    return Sweep(plan, combinations, *resume_jobs("sweep", queue, out, workers, progress))


def list_columns(plan: Plan) -> list[str]:
    """Return the names of a plan's columns, in their order."""
    results = ("grid_poses", *IDS, *ERRORS, *COVERAGES, "nll_nats", "error", "key", *MOMENTARY)
    return [*IDENTITY, *list_varied_columns(plan), *results]


def list_varied_columns(plan: Plan) -> list[str]:
    """Return "slot.option" for each option that differs between choices of one component."""
    return [f"{slot}.{option}" for slot, choices in plan.slots.items() for option in find_varied_options(choices)]


def make_rows(plan: Plan, combinations: Iterable[Combination], outcomes: Mapping[str, JobOutcome]) -> list[Row]:
    """Return a row with all columns for each combination, as JSON values; missing values are None."""
    columns, varied = list_columns(plan), [column.split(".", 1) for column in list_varied_columns(plan)]
    rows = []
    for one in combinations:
        outcome, config = outcomes[one.key], one.config
        slots = {slot: getattr(config, slot) for slot in SLOTS}
        known = {
            "object": one.object,
            **{slot: chosen.name for slot, chosen in slots.items()},
            "noise": config.touch.noise,
            "seed": config.seed,
            "count": one.count,
            **{f"{slot}.{option}": slots[slot].options.get(option) for slot, option in varied},
            **(outcome.measured or {}),
            "error": outcome.error,
            "key": one.key,
            "built": json.dumps(list(outcome.built)),
        }
        rows.append({column: known.get(column) for column in columns})
    return rows


def require_line(line: str) -> str:
    """Return `line` if it is a line of the protocol. Raises ConfigError otherwise."""
    if line not in LINES:
        raise ConfigError(f"there is no line {line!r}; {advise_choice(line, LINES)}")
    return line


def write_sweep_tables(out: Path, sweep: Sweep, line: str) -> list[Path]:
    """Write the tables of a sweep into the folder `out` and return their paths. Raises OutputError.

    The summary shows the errors of `line`, one of the protocol's LINES.
    """
    csv, summary = format_csv(sweep.rows), format_summary(sweep, line)
    written = write_texts(out, "sweep", record_sweep(sweep, line), csv=csv, md=summary)
    return [*written, write_parquet(out / "sweep.parquet", sweep.rows)]


def record_sweep(sweep: Sweep, line: str) -> dict[str, Any]:
    """Return the plan, the versions, the number of built stages, and each row with its settings, as JSON values."""
    configurations = {one.key: one.describe() for one in sweep.combinations}
    return build_document(
        SCHEMA_VERSION,
        protocol_version=PROTOCOL_VERSION,
        line=line,
        plan=sweep.plan.describe(),
        combinations=len(sweep.combinations),
        failed=sweep.failed,
        built=sweep.built,
        rows=[{**row, "configuration": configurations[row["key"]]} for row in sweep.rows],
    )


def read_sweep(folder: Path) -> dict[str, Any]:
    """Read the sweep.json of a folder. Raises ConfigError if the file is missing or damaged."""
    path = folder / "sweep.json"
    try:
        found = read_json(path)
        _require_rows(found["rows"])
        _ = dict(found["versions"])
    except FileNotFoundError as error:
        raise ConfigError(f"there is no file {path}; give the `out` folder of a finished sweep") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path} is damaged ({type(error).__name__}); run this sweep again") from error
    return dict(found)


def _require_rows(rows: list[dict[str, Any]]) -> None:
    """Raise an error that `read_sweep` catches if a row lacks its combination, or has an error that is not a number."""
    if not rows:
        raise ValueError("it has no row")
    for row in rows:
        chosen = [row["configuration"][slot] for slot in SLOTS]
        said = [row[name] for name in IDENTITY], [(one["name"], one["options"].items()) for one in chosen]
        medians = [value for name, value in row.items() if name.endswith("_median_mm")]
        if not said or not all(value is None or isinstance(value, int | float) for value in medians):
            raise ValueError("an error is not a number")


def format_summary(sweep: Sweep, line: str) -> str:
    """Return, as Markdown, a table for each noise with the median ADD of `line`, mm, and a list of failures."""
    plan = sweep.plan
    seeds = f", mean over seeds {', '.join(map(str, plan.seeds))}" if len(plan.seeds) > 1 else ""
    parts: list[str | Table] = [
        f"Median ADD (symmetric poses equal) of `{line}` over {plan.count} simulated touches, "
        f"mm{seeds}. The best value of each column is bold."
    ]
    same = [f"{slot} {choices[0].name}" for slot, choices in plan.slots.items() if len(choices) == 1]
    if same:
        parts.append(f"Common to all rows: {', '.join(same)}.")
    parts += [_state_changes(sweep.find_changed())] if sweep.find_changed() else []
    medians = sweep.compute_medians(line)
    for noise in plan.noises:
        parts += [f"## Noise: {noise}", tabulate_medians(medians, noise, _mark_best)]
    if sweep.failed:
        parts += [f"## Failed: {sweep.failed} of {len(sweep.combinations)}", "\n".join(_list_failures(sweep))]
    return format_document(f"Sweep: {line}", parts)


def _state_changes(changed: Mapping[str, Sequence[str]]) -> str:
    """State which slots change the grid or the touches."""
    said = [f"`{slot}` also changes the {' and the '.join(names)}" for slot, names in changed.items()]
    return f"Not all else is equal: {'; '.join(said)}. The columns {' and '.join(IDS)} show which rows share them."


def tabulate_medians(medians: Sequence[ChoiceMedian], noise: str, cell: Callable[[float, float], str]) -> Table:
    """Return a row for each label, and a column for each object, for one noise.

    `cell` gives the text of an error, mm, beside the best error of the column. A failed combination has FAILED.
    """
    found = [median._asdict() for median in medians if median.noise == noise]
    best_mm: dict[str, float] = {}
    for one in found:
        best_mm[one["object"]] = np.fmin(one["error_mm"], best_mm.get(one["object"], np.nan))

    def format_cell(one: dict[str, Any]) -> str:
        return FAILED if math.isnan(one["error_mm"]) else cell(one["error_mm"], best_mm[one["object"]])

    header, *rows = pivot(found, ("label",), "object", format_cell)
    return [["components", *header[1:]], *rows]


def _mark_best(error_mm: float, best_mm: float) -> str:
    """Return an error in mm, in bold if it is the best."""
    text = format_mm(1e-3 * error_mm)
    return f"**{text}**" if text == format_mm(1e-3 * best_mm) else text


def _list_failures(sweep: Sweep) -> Iterator[str]:
    for one in sweep.combinations:
        error = sweep.outcomes[one.key].error
        if error:
            names = ", ".join(getattr(one.config, slot).name for slot in sweep.plan.slots)
            yield f"- {one.object}, {names}, noise {one.config.touch.noise}, seed {one.config.seed}: {error}"
