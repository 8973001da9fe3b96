"""The report of an evaluation from one touch: tables, errors, trust in the probabilities, times, galleries."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.evaluation.posterior_metrics import LEVELS
from tactile_loc.evaluation.tables import SCHEMA_VERSION, SHOWN
from tactile_loc.evaluation.tabular import mm
from tactile_loc.reports.documents import guarded, named_runs, require_version, settings_details
from tactile_loc.reports.markup import choice, escape, figure, table, tiles
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.pngs import picture
from tactile_loc.reports.source import Source

METRIC_NAMES = {"add": "ADD", "mssd": "MSSD", "add-s": "ADD-S"}
SCALES = {"mm": "mm", "share": "share of a random pose's mean"}
FIRST_LINE = "chosen"  # what the curves begin with, if the evaluation has it
DIGITS = 6


def evaluation_page(source: Source) -> Page:
    """Return the page of an evaluation. Raises ResultError when its files cannot be used."""
    document = source.document()
    require_version(source, document, SCHEMA_VERSION)
    return guarded(source, lambda: _page(source, document))


def _page(source: Source, document: dict[str, Any]) -> Page:
    runs = document["runs"]
    names = named_runs(runs)
    lines, metrics = list(runs[0]["errors_m"]), list(next(iter(runs[0]["errors_m"].values())))
    sections = [
        Section("summary", "", tiles(_tiles(document))),
        Section("medians", "Medians", _medians(runs, names)),
        Section("errors", "Errors", _errors(runs, names, lines, metrics)),
        Section("trust", "Can the probabilities be trusted?", _trust(runs, names)),
        Section("times", "Times", _times(runs, names)),
        Section("gallery", "Best, median and worst touches", _gallery(source.folder, runs)),
        Section("made", "Made with", settings_details(document, names)),
    ]
    shown = [section for section in sections if section.body]
    data = {"runs": [_run(run, name) for run, name in zip(runs, names, strict=True)], "lines": lines}
    return Page(f"Evaluation: {_objects(runs)}", _about(document), shown, data, ["errors.js", "evaluation.js"])


def _objects(runs: Sequence[dict[str, Any]]) -> str:
    found = list(dict.fromkeys(run["object"] for run in runs))
    return ", ".join(found) if len(found) < 7 else f"{len(found)} objects"


def _about(document: dict[str, Any]) -> str:
    protocol = document["protocol"]
    kind = "simulated images" if protocol.get("images") else "simulated touches"
    return (
        f"{protocol['touches']} {kind} of each object, noise {protocol['noise']}, seed {protocol['seed']}; "
        f"protocol {protocol['version']}; {document['created']}"
    )


def _tiles(document: dict[str, Any]) -> list[tuple[str, str, str]]:
    runs = document["runs"]
    line = _first(list(runs[0]["errors_m"]))
    medians = [run["lines"][line]["add"] for run in runs]
    middle_mm = mm(float(np.median([m["metres"]["median"] for m in medians])))
    share = float(np.median([m["normalised"]["median"] for m in medians]))
    covered = np.mean([run["posterior"]["coverage"] for run in runs], axis=0)
    of_all = f"the median of {len(runs)} medians" if len(runs) > 1 else f"of {runs[0]['object']}"
    found = [
        (f"median ADD, {line}", f"{middle_mm} mm", of_all),
        ("of a random pose's mean", f"{share:.3f}", "the same, as a share"),
    ]
    levels = runs[0]["posterior"].get("levels", LEVELS)
    return found + [
        (
            f"in the {100 * level:.0f} % set",
            f"{100 * held:.0f} %",
            f"of the true poses; right would be {100 * level:.0f} %",
        )
        for level, held in zip(levels, covered, strict=True)
    ]


def _first(lines: Sequence[str]) -> str:
    return FIRST_LINE if FIRST_LINE in lines else lines[0]


def _medians(runs: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    lines = [line for line in SHOWN if line in runs[0]["lines"]]
    header = ["object", "grid poses", *lines]
    lengths, shares = (
        [[name, run["grid_poses"], *(write(run["lines"][line]["add"][unit]["median"]) for line in lines)]
         for run, name in zip(runs, names, strict=True)]
        for unit, write in (("metres", mm), ("normalised", "{:.3f}".format))
    )  # fmt: skip
    note = (
        "<p class='note'>ADD: the mean distance between the object's surface points at the estimated and at the true "
        "pose, the least over its symmetry. best-k: the best of the k most probable grid poses; reg-k: refined; "
        "chosen: the refined pose that explains the touch best; closest: the best pose of the grid; random: any.</p>"
    )
    return (
        f"{note}<h3>median ADD, mm</h3>{table(header, lengths, label='median ADD, mm')}<h3>median ADD as a share of a "
        f"random pose's mean</h3>{table(header, shares, label='median ADD as a share of the mean of a random pose')}"
    )


def _errors(runs: Sequence[dict[str, Any]], names: Sequence[str], lines: Sequence[str], metrics: Sequence[str]) -> str:
    objects = {"": "all, by line", **{str(i): name for i, name in enumerate(names)}}
    measures = {metric: METRIC_NAMES.get(metric, metric) for metric in metrics}
    choices = (
        choice("object", "object", objects if len(runs) > 1 else {"0": names[0]}) + choice("metric", "error", measures)
        + choice("scale", "in", SCALES) + choice("shape", "as", {"violin": "violins", "box": "boxes"})
    )  # fmt: skip
    curve = choice("line", "line", lines, _first(lines))
    return (
        f'<div class="choices">{choices}</div>'
        + figure("errors", "Distribution of the errors over the touches; the axis is logarithmic. Click on a name to "
                 "show or hide it.", size="tall3d")
        + f'<div class="choices">{curve}</div>'
        + figure("curves", "Share of the touches whose error is at most so large.")
    )  # fmt: skip


def _trust(runs: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    levels = runs[0]["posterior"].get("levels", LEVELS)
    header = ["object", *(f"in the {100 * level:.0f} % set" for level in levels), "NLL (nats)", "of knowing nothing",
              "entropy (nats)", "expected error (mm)", "spread (mm)"]  # fmt: skip
    rows = []
    for run, name in zip(runs, names, strict=True):
        trust = run["posterior"]
        held = [f"{100 * share:.0f} %" for share in trust["coverage"]]
        nats = [f"{trust[key]:.2f}" for key in ("nll", "uniform_nll", "entropy")]
        rows.append([name, *held, *nats, mm(trust["expected_error_m"]), mm(trust["spread_m"])])
    covered = figure("coverage", "How often the truth lies in the smallest set of poses with so much probability. On "
                     "the dashed line the probabilities are true; below it, too sure.")  # fmt: skip
    entropy = figure("entropy", "Error against the posterior's entropy: where it is low, errors should be small.")
    return f'{table(header, rows, label="trust")}<div class="split"><div>{covered}</div><div>{entropy}</div></div>'


def _times(runs: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    stages = list(runs[0]["median_seconds"])
    rows = [[name, *(f"{1e3 * run['median_seconds'][stage]:.2f}" for stage in stages)]
            for run, name in zip(runs, names, strict=True)]  # fmt: skip
    caption = "Median time of each stage for one touch; refining one pose."
    return table(["object", *(f"{s} (ms)" for s in stages)], rows, label="times") + figure("times", caption)


def _gallery(folder: Path, runs: Sequence[dict[str, Any]]) -> str:
    parts = []
    for run in runs:
        path = folder / f"gallery-{run['object']}-{run['encoder']}.png"
        uri = picture(path) if path.parent == folder else None
        if uri is not None:
            about = f"{run['object']} with {run['encoder']}"
            parts.append(f'<figure><img alt="touches of {escape(about)}" src="{uri}"></figure>')
    return f'<div class="gallery">{"".join(parts)}</div>' if parts else ""


def _run(run: dict[str, Any], name: str) -> dict[str, Any]:
    """What scripts draw of a run; mm, nats, ms."""
    errors = {
        line: {metric: [_short(1e3 * e) for e in values] for metric, values in by_metric.items()}
        for line, by_metric in run["errors_m"].items()
    }
    return {
        "name": name, "errors_mm": errors, "random_mm": {m: 1e3 * v for m, v in run["random_mean_m"].items()},
        **{name: [_short(v) for v in run["posterior_metrics"][name]] for name in ("credible_level", "entropy")},
        "levels": run["posterior"].get("levels", list(LEVELS)), "coverage": run["posterior"]["coverage"],
        "times": [[stage, 1e3 * s] for stage, s in run["median_seconds"].items()],
    }  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
