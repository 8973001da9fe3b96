"""The results of the paper's protocol, by touch and by number of contacts, as tables, and as JSON in SI units.

The paper is Bauza et al., Tactile Object Pose Estimation from the First Touch with Geometric Contact Rendering (CoRL
2020). PUBLISHED has its own results.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.metrics import LEVELS
from tactile_loc.evaluation.paper.fusion import FUSED_LINES, FUSION_LINES, FUSION_VERSION
from tactile_loc.evaluation.protocol import LINES, PROTOCOL_VERSION, STAGES
from tactile_loc.evaluation.summary import find_scale_m, measure_coverage, summarise_lines
from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable, join_runs
from tactile_loc.evaluation.text_tables import (
    EvaluationResults,
    NotedTable,
    Row,
    Table,
    build_document,
    format_share,
    pivot,
    tabulate,
)

TOUCH_SCHEMA, CONTACTS_SCHEMA, PAPER_SCHEMA = 4, 3, 2
PUBLISHED: Mapping[str, Mapping[str, float]] = {  # the paper's normalised medians, by demo object and line
    "pin": {"best-1": 0.11},
    "damping_pin": {"best-1": 0.16},
    "head": {"best-1": 0.18},
    "elbow_pipe": {"best-1": 0.87, "best-10": 0.26, "best-50": 0.08},
}
PAPER_LINES = ("best-1", "reg-1", "best-10", "reg-10", "best-50", "closest", "random")
SHOWN = tuple(line for line in LINES if line != "random-10")  # the lines in the summary
SHARE_TITLE = "median ADD divided by the mean ADD of random poses"
SHARE_NOTE = "divided by the mean error of a random pose. Symmetric poses count as equal."
COVERAGE_NOTE = (
    "Coverage: the share of true poses in the smallest sets of poses that hold 50, 80 and 95 % of the probability. "
    "NLL: the mean negative log-likelihood of the grid pose nearest to the truth, beside that of a uniform posterior. "
    "Expected error and spread: the mean distance of the posterior's poses from the truth and from its most probable "
    "pose:"
)
CONTACTS_NOTE = (
    f"ADD of the most probable pose in mm and, in brackets, {SHARE_NOTE} `reg-1` is this pose, "
    "refined to all contacts. `kinematic` uses contact only, and takes one of the poses that touch all sensors. "
    "Without common pose: examples in which no grid pose touches all sensors; they are located from the first contact "
    "only."
)
BY_LINE = (
    "Median ADD from one touch, divided by the mean ADD of a random pose. Rows `paper` are the paper's own numbers:"
)
BY_CONTACTS = "The same by number of contacts:"


def summarise_touches(table: ExampleTable) -> list[Row]:
    """Return a row for each object and encoder: median times, and means of the posteriors.

    `coverage` has, for each of LEVELS, the share of touches whose true pose is in the credible set of this level.
    `uniform_nll_nats` is the negative log-likelihood of a uniform posterior.
    """
    rows = []
    for (name, encoder), run in table.group("object", "encoder").items():
        means = ("nll_nats", "entropy_nats", "expected_error_m", "spread_m")
        rows.append(
            {
                "object": name,
                "encoder": encoder,
                "touches": len(run),
                "refused": run.count_refused(),
                "random_mean_m": find_scale_m(run),
                "median_seconds": {stage: float(np.median(run[f"{stage}_s"])) for stage in STAGES},
                "levels": list(LEVELS),
                "coverage": measure_coverage(run),
                "uniform_nll_nats": float(np.log(run["grid_poses"][0])),
                **{name: float(run[name].mean()) for name in means},
            }
        )
    return rows


# ---- from one touch


def format_share_of_random(row: Row) -> str:
    """Return the median error of a row of `summarise_lines` as a share of a random pose's mean error."""
    return f"{row['median_normalised']:.3f}"


def format_median(row: Row) -> str:
    """Return the median error of a row of `summarise_lines` in mm."""
    return format_mm(row["median_m"])


def format_both(row: Row) -> str:
    """Return the median error of a row of `summarise_lines` in mm, and in brackets as a share."""
    return f"{format_median(row)} ({format_share_of_random(row)})"


def _name_run(row: Row) -> dict[str, str]:
    return {name: row[name] for name in ("object", "encoder")}


def tabulate_medians(rows: Sequence[Row], cell: Callable[[Row], str] = format_both) -> Table:
    """Return a row for each object and encoder, from `summarise_lines`: the `cell` of each line of SHOWN."""
    shown = [row for row in rows if row["line"] in SHOWN]
    return pivot(shown, ("object", "encoder"), "line", cell)


def tabulate_posteriors(rows: Sequence[Row]) -> Table:
    """Return a row for each row of `summarise_touches`: the coverage of the credible sets, and mean metrics."""
    nats = {"NLL, nats": "nll_nats", "uniform": "uniform_nll_nats", "entropy": "entropy_nats"}
    lengths = {"expected error, mm": "expected_error_m", "spread, mm": "spread_m"}
    return tabulate(
        {
            **_name_run(row),
            **{name_set(level): format_share(held) for level, held in zip(row["levels"], row["coverage"], strict=True)},
            **{head: f"{row[name]:.2f}" for head, name in nats.items()},
            **{head: format_mm(row[name]) for head, name in lengths.items()},
        }
        for row in rows
    )


def name_set(level: float) -> str:
    """Return the name of the credible set of a level, 0 to 1."""
    return f"in the {100 * level:.0f} % set"


def tabulate_times(rows: Sequence[Row]) -> Table:
    """Return a row for each row of `summarise_touches`: the median time of each stage, ms."""
    return tabulate(
        {**_name_run(row), **{stage: f"{1e3 * row['median_seconds'][stage]:.1f}" for stage in STAGES}} for row in rows
    )


def _list_lengths(row: Row) -> dict[str, str]:
    lengths = {name: format_mm(row[f"{name}_m"]) for name in ("median", "mean", "std")}
    return {**lengths, "quartiles": f"{format_mm(row['q25_m'])} to {format_mm(row['q75_m'])}"}


def _list_shares(row: Row, names: Sequence[str] = ("median", "mean")) -> dict[str, str]:
    return {f"{name} / random": f"{row[f'{name}_normalised']:.3f}" for name in names}


def _list_details(
    table: ExampleTable, rows: Sequence[Row], cells: Callable[[Row], Row], describe: Callable[[ExampleTable], str]
) -> list[str | Table]:
    """Return a heading, a description, and a table of the `cells` of all rows, for each object and encoder."""
    parts: list[str | Table] = []
    for (name, encoder), run in table.group("object", "encoder").items():
        about = f"{run['grid_poses'][0]} grid poses, symmetry {run['symmetry'][0]}; {describe(run)}"
        own = [row for row in rows if (row["object"], row["encoder"]) == (name, encoder)]
        parts += [f"## {name}, {encoder}", about, tabulate(map(cells, own))]
    return parts


def collect_touches(runs: Sequence[EvaluatedRun], protocol: Mapping[str, Any], heading: str) -> EvaluationResults:
    """Return all results from one touch, called "results"; `protocol` states the touches, noise and seed."""
    table = join_runs(runs)
    lines, touches = summarise_lines(table, LINES), summarise_touches(table)
    document = build_document(
        TOUCH_SCHEMA,
        protocol={"version": PROTOCOL_VERSION, **protocol},
        runs=[{**run.describe(), **row} for run, row in zip(runs, touches, strict=True)],
        summary=lines,
        examples=table.describe(),
    )
    tables = [
        NotedTable("", f"Median ADD in mm and, in brackets, {SHARE_NOTE}", tabulate_medians(lines)),
        NotedTable("median ADD, mm", "", tabulate_medians(lines, format_median)),
        NotedTable("", "Median time of each stage, ms:", tabulate_times(touches)),
        NotedTable("", COVERAGE_NOTE, tabulate_posteriors(touches)),
    ]

    def list_cells(row: Row) -> Row:
        return {"line": row["line"], **_list_lengths(row), "90 %": format_mm(row["p90_m"]), **_list_shares(row)}

    details = _list_details(table, lines, list_cells, lambda run: f"{_describe_refused(run)}; ADD, mm:")
    rows = [{name: row[name] for name in row if name not in ("contacts", "without_common")} for row in lines]
    return EvaluationResults("results", heading, document, rows, tables, details)


def _describe_refused(run: ExampleTable) -> str:
    return f"{run.count_refused()} presses without a touch were refused"


# ---- by number of contacts


def name_contacts(number: int) -> str:
    """Return a number of contacts with its noun."""
    return "1 contact" if number == 1 else f"{number} contacts"


def tabulate_contacts(rows: Sequence[Row], cell: Callable[[Row], str] = format_both) -> Table:
    """Return a row for each object, encoder and line, from `summarise_lines`: the `cell` by number of contacts."""
    named = [{**row, "contacts": name_contacts(row["contacts"])} for row in rows]
    return pivot(named, ("object", "encoder", "line"), "contacts", cell)


def collect_contacts(runs: Sequence[EvaluatedRun], protocol: Mapping[str, Any], heading: str) -> EvaluationResults:
    """Return all results by number of contacts, called "contacts"; `protocol`: see `collect_touches`."""
    table = join_runs(runs)
    rows = summarise_lines(table, FUSED_LINES)
    document = build_document(
        CONTACTS_SCHEMA,
        protocol={"version": FUSION_VERSION, "contacts": np.unique(table["touches"]).tolist(), **protocol},
        runs=[{**run.describe(), "random_mean_m": find_scale_m(run.table)} for run in runs],
        summary=summarise_lines(table, FUSION_LINES),
        examples=table.describe(),
    )
    tables = [NotedTable("", f"{CONTACTS_NOTE}\n\nMedians:", tabulate_contacts(rows))]

    def list_cells(row: Row) -> Row:
        shares = _list_shares(row, ("median", "mean", "std"))
        without = {"without common pose": str(row["without_common"])}
        return {"line": row["line"], "contacts": str(row["contacts"]), **_list_lengths(row), **shares, **without}

    def describe(run: ExampleTable) -> str:
        random = f"mean error of a random pose {format_mm(find_scale_m(run))} mm"
        return f"{random}; {_describe_refused(run)}"

    details = _list_details(table, rows, list_cells, describe)
    return EvaluationResults("contacts", heading, document, rows, tables, details)


# ---- beside the paper


def collect_paper(
    touches: Sequence[EvaluatedRun], contacts: Sequence[EvaluatedRun], protocol: Mapping[str, Any], heading: str
) -> EvaluationResults:
    """Return the normalised results from one touch and by number of contacts beside the paper's, called "paper".

    `protocol` states how they were measured.
    """
    single = [
        {**row, "published_median_normalised": _find_published(run).get(row["line"])}
        for run in touches
        for row in summarise_lines(run.table, PAPER_LINES)
    ]
    several = summarise_lines(join_runs(contacts), FUSED_LINES)
    rows = [
        *({"part": "touches", **row} for row in single),
        *({"part": "contacts", **row, "published_median_normalised": None} for row in several),
    ]
    shares = tabulate_contacts(several, format_share_of_random)
    document = build_document(PAPER_SCHEMA, protocol=dict(protocol), summary=rows)
    tables = [
        NotedTable(f"{SHARE_TITLE}, from one touch", BY_LINE, tabulate_published(single)),
        NotedTable(f"{SHARE_TITLE}, by number of contacts", BY_CONTACTS, shares),
    ]
    return EvaluationResults("paper", heading, document, rows, tables)


def _find_published(run: EvaluatedRun) -> Mapping[str, float]:
    """Return the paper's normalised medians of a run's demo object, by line; none for another object."""
    return PUBLISHED.get(run.configuration.get("object", {}).get("path", ""), {})


def tabulate_published(rows: Sequence[Row]) -> Table:
    """Return a row for each object and encoder, from the rows of `collect_paper`, and a row of the paper's numbers."""
    cells = []
    for row in rows:
        published = row["published_median_normalised"]
        cells.append({**row, "source": "measured", "cell": format_share_of_random(row)})
        cells.append({**row, "source": "paper", "cell": "-" if published is None else f"{published:.2f}"})
    header, *found = pivot(cells, ("object", "encoder", "source"), "line", lambda row: row["cell"])
    return [header, *(line for line in found if set(line[3:]) != {"-"})]
