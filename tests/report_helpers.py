"""Small results for reports, and a parser of report pages."""

import base64
import dataclasses
import itertools
import json
import re
from collections.abc import Callable, Mapping
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc import Localizer, Plan
from tactile_loc.evaluation.jobs import JobOutcome
from tactile_loc.evaluation.metrics import METRICS as RECALL_METRICS
from tactile_loc.evaluation.metrics import POSTERIOR_METRICS
from tactile_loc.evaluation.paper.fusion import FUSED_LINES, FUSION_LINES
from tactile_loc.evaluation.protocol import LINES, STAGES
from tactile_loc.evaluation.recall.tables import collect_answers
from tactile_loc.evaluation.sweep.combination import TIMED_LINES, TOUCHES, Combination, combine
from tactile_loc.evaluation.sweep.sweep import MEASURED, Sweep
from tactile_loc.evaluation.sweep.tables import record_sweep
from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable, name_errors
from tactile_loc.evaluation.text_tables import Row
from tactile_loc.reports import find_result
from tactile_loc.reports.page import Page, render
from tactile_loc.reports.report import make_page

UNFRIENDLY = "<script>alert('x')</script>&amp;\"\u2028"
SWEPT = ("none", "icp", "filterreg")
EFFECT = {"none": 4.0, "icp": 1.0, "filterreg": 0.5}


def write_run(folder: Path, localizer: Localizer, touch_name: str | None = None) -> Path:
    """Locate a simulated touch and write result.json and result.npz."""
    touch = localizer.simulate(1, seed=0)[0]
    touch = dataclasses.replace(touch, name=touch_name or touch.name)
    localization = localizer.localize(touch)
    dataclasses.replace(localization, seconds={"model": 1.5, **localization.seconds}).save(folder)
    return folder


def make_touch_table(name: str, encoder: str, seed: int, touches: int = 12) -> ExampleTable:
    """The table of an evaluation from one touch, with random errors."""
    rng = np.random.default_rng(seed)
    errors_m = rng.uniform(1e-4, 3e-2, (touches, len(LINES), 1))
    stages = dict(zip([f"{stage}_s" for stage in STAGES], rng.uniform(0, 0.01, (len(STAGES), touches)), strict=True))
    metrics = dict(zip(POSTERIOR_METRICS, rng.uniform(0, 1, (len(POSTERIOR_METRICS), touches)), strict=True))
    return ExampleTable.make(
        {**name_errors(errors_m, LINES, ("add",)), **stages, **metrics},
        object=name, symmetry="z2", encoder=encoder, noise="mild", seed=1, grid_poses=500, touches=1,
        example=np.arange(touches), refused=np.arange(touches),
    )  # fmt: skip


CONTACTS = (1, 2, 5)


def make_contact_table(name: str, encoder: str, seed: int, examples: int = 40) -> ExampleTable:
    """Examples whose errors fall with the number of contacts; four have no pose common to five contacts."""
    rng = np.random.default_rng(seed)
    scales = 1e-3 * np.array([[20, 19, 40, 40], [5, 4, 30, 40], [2, 1, 15, 40]])
    errors_m = (scales * rng.uniform(0.5, 1.5, (examples, 3, 4))).reshape(-1, 4, 1)
    example, touches = np.repeat(np.arange(examples), 3), np.tile(CONTACTS, examples)
    alone = (example < 4) & (touches == 5)
    return ExampleTable.make(
        {**name_errors(errors_m, FUSION_LINES, ("add",)), **{f"{line} alone": alone for line in FUSED_LINES}},
        object=name, symmetry="none", encoder=encoder, noise="mild", seed=1, grid_poses=1000, touches=touches,
        example=example, refused=2,
    )  # fmt: skip


def make_recall_runs(names: tuple[str, ...] = ("pin", "hook"), examples: int = 12) -> list[EvaluatedRun]:
    """Runs of 1 and 3 touches with random results: noises none and strong, the second example without a pose."""
    runs = []
    for seed, (name, noise) in enumerate(itertools.product(names, ("none", "strong"))):
        rng, count = np.random.default_rng(seed), 2 * examples
        errors_m = 10 ** rng.uniform(-4.5, -1.5, (count, 4, len(RECALL_METRICS)))
        probability = rng.uniform(0, 0.5, (count, 4)).max(axis=1)
        verdict = rng.choice(["certain", "ambiguous"], count)
        problem, seconds = np.full(count, "", "U40"), rng.uniform(0.1, 1, count)
        errors_m[2:4], probability[2:4], seconds[2:4] = np.inf, np.nan, np.nan
        verdict[2:4], problem[2:4] = "refused", "the file is damaged"
        table = ExampleTable.make(
            {
                **name_errors(np.stack([errors_m[:, 0], errors_m.min(axis=1)], 1), ("first", "listed"), RECALL_METRICS),
                "probability": probability,
                "verdict": verdict, "problem": problem, "determined": rng.random(count) < 0.7, "seconds": seconds,
            },
            object=name, symmetry="z2", diameter_m=0.05, encoder="pixel", noise=noise, seed=5, refused=1,
            example=np.repeat(np.arange(examples), 2), touches=np.tile([1, 3], examples),
        )  # fmt: skip
        runs.append(EvaluatedRun(table, {"grid": {"name": "whole"}}))
    return runs


def write_recall(folder: Path, names: tuple[str, ...] = ("pin", "hook")) -> Path:
    """Write the files of an evaluation of what `run` answers, with random results."""
    about = {"examples": 12, "noises": ["none", "strong"], "seeds": [5], "images": False}
    collect_answers(make_recall_runs(names), about, "title").write(folder)
    return folder


def make_sweep(values: dict[str, Any], measure: Callable[[Combination], Mapping[str, float] | str]) -> Sweep:
    """A sweep of a plan's values; `measure` gives some columns of each combination, or the text of its error."""
    plan = Plan.from_values(values)
    combinations, _ = combine(plan)
    outcomes = {}
    for one in combinations:
        found = measure(one)
        if isinstance(found, str):
            outcomes[one.key] = JobOutcome(one.key, None, error=found)
        else:
            zeros = dict.fromkeys(MEASURED, 0.0)
            measured = {"grid_poses": 7, **zeros, **found}
            touches = {f"{line}_mm": [measured[f"{line}_median_mm"]] * one.count for line in LINES}
            touches |= {f"{line}_ms": [measured[f"{line}_ms"]] * one.count for line in TIMED_LINES}
            measured[TOUCHES] = {**touches, "refused": [0] * one.count, **measured.get(TOUCHES, {})}
            outcomes[one.key] = JobOutcome(one.key, measured, (f"grid {one.key}",))
    return Sweep(plan, combinations, outcomes, len(combinations))


@cache
def describe_sweep() -> str:
    """The JSON of twelve combinations; each refiner multiplies the error by its EFFECT for every object and spacing."""

    def measure(one: Combination) -> dict[str, float]:
        size = (3.0 if one.object == "pin" else 7.0) * one.config.grid.options["spacing_mm"]
        error_mm = EFFECT[one.config.refiner.name] * size
        return {"best-1_median_mm": 2 * error_mm, "chosen_median_mm": error_mm, "chosen_ms": 10 / error_mm}

    varied = {"object": ["pin", "hook"], "refiner": list(SWEPT), "option": ["grid.spacing_mm=4,6"]}
    return json.dumps(record_sweep(make_sweep({**varied, "count": 6}, measure), "chosen"))


def write_sweep(folder: Path, change: Callable[[list[Row]], object] = lambda rows: None) -> Path:
    """Write sweep.json, after a change of its rows."""
    document = json.loads(describe_sweep())
    change(document["rows"])
    (folder / "sweep.json").write_text(json.dumps(document))
    return folder


def page_in(folder: Path) -> Page:
    return make_page(find_result(folder))


def html_of(folder: Path) -> str:
    return render(page_in(folder))


def floats(packed: str) -> np.ndarray:
    """The numbers of a packed array in a page."""
    return np.frombuffer(base64.b64decode(packed), "<f4")


class Elements(HTMLParser):
    """The elements of a page with their attributes, the text outside scripts and styles, and the cells of tables."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.rows: list[list[str]] = []
        self._within = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._within = tag
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        if self._within in ("script", "style"):
            return
        self.text += data
        if self._within in ("td", "th"):
            self.rows[-1][-1] += data

    def handle_endtag(self, tag: str) -> None:
        self._within = ""

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def numbers_in(text: str) -> list[float]:
    """All numbers of a text."""
    return [float(word) for word in re.findall(r"-?\d+(?:\.\d+)?", text)]
