"""Small results for reports, and a parser of report pages."""

from __future__ import annotations

import base64
import dataclasses
import itertools
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.evaluation.fusion import FusionEvaluation
from tactile_loc.evaluation.fusion_tables import FusionRun, write_fusion_tables
from tactile_loc.evaluation.metrics import POSTERIOR_METRICS
from tactile_loc.evaluation.protocol import LINES, METRICS, STAGES, Evaluation
from tactile_loc.evaluation.recall.evaluation import METRICS as RECALL_METRICS
from tactile_loc.evaluation.recall.evaluation import RecallEvaluation
from tactile_loc.evaluation.recall.summary import RecallRun
from tactile_loc.evaluation.recall.tables import write_recall_tables
from tactile_loc.evaluation.tables import Run, write_tables
from tactile_loc.locate.localizer import Localizer
from tactile_loc.reports import find_source
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


def write_evaluation(folder: Path, names: tuple[str, ...] = ("pin", "hook"), touches: int = 12) -> Path:
    """Write the files of an evaluation with random errors, and one gallery."""
    from PIL import Image

    runs = []
    for seed, name in enumerate(names):
        rng = np.random.default_rng(seed)
        errors = rng.uniform(1e-4, 3e-2, (touches, len(LINES), len(METRICS)))
        poses = np.broadcast_to(np.eye(4), (touches, len(LINES), 4, 4))
        seconds, posterior_metrics = (
            rng.uniform(0, 0.01, (touches, len(STAGES))),
            rng.uniform(0, 1, (touches, len(POSTERIOR_METRICS))),
        )
        ratios, shares = rng.uniform(0, (3, 0.2), (touches, 2)).T
        found = Evaluation(errors, poses, seconds, posterior_metrics, ratios, shares, np.zeros(touches, int))
        runs.append(Run(name, "z2", "pixel", 500, found, {"grid": {"name": "face"}}))
    write_tables(folder, runs, {"touches": touches, "noise": "mild", "seed": 1, "images": False}, "title")
    Image.new("RGB", (2000, 300), "white").save(folder / "gallery-pin-pixel.png")
    return folder


def write_contacts(folder: Path) -> Path:
    """Write the files of an evaluation from 1, 2 and 5 contacts."""
    errors = 1e-3 * np.random.default_rng(0).uniform(1, 30, (9, 3, 3))
    alone = np.zeros((9, 3, 2), bool)
    alone[:4, 2] = True
    run = FusionRun("pin", "none", "pixel", 100, FusionEvaluation((1, 2, 5), errors, alone, np.arange(9)))
    write_fusion_tables(folder, [run], {"examples": 9, "noise": "mild", "seed": 1}, "title")
    return folder


def make_recall_runs(names: tuple[str, ...] = ("pin", "hook"), examples: int = 12) -> list[RecallRun]:
    """Runs of 1 and 3 touches with random results: noises none and strong, the second example without a pose."""
    runs = []
    for seed, (name, noise) in enumerate(itertools.product(names, ("none", "strong"))):
        rng = np.random.default_rng(seed)
        shape = (examples, 2, 4)
        errors_m = 10 ** rng.uniform(-4.5, -1.5, (*shape, len(RECALL_METRICS)))
        probabilities = np.sort(rng.uniform(0, 0.5, shape))[..., ::-1]
        poses = np.broadcast_to(np.eye(4), (*shape, 4, 4)).copy()
        verdict = rng.choice(["certain", "ambiguous"], shape[:2])
        problem, seconds = np.full(shape[:2], "", "U40"), rng.uniform(0.1, 1, shape[:2])
        errors_m[1], poses[1], probabilities[1], seconds[1] = np.inf, np.nan, np.nan, np.nan
        verdict[1], problem[1] = "refused", "the file is damaged"
        found = RecallEvaluation(
            (1, 3), poses, probabilities, errors_m, verdict, problem, rng.random(shape[:2]) < 0.7, seconds,
            poses[:, 0, 0], np.ones(examples, int),
        )  # fmt: skip
        runs.append(RecallRun(name, "z2", 0.05, "pixel", noise, 5, found, {"grid": {"name": "whole"}}))
    return runs


def write_recall(folder: Path) -> Path:
    """Write the files of an evaluation of what `run` answers, with random results."""
    about = {"examples": 12, "noises": ["none", "strong"], "seeds": [5], "images": False}
    write_recall_tables(folder, make_recall_runs(), about, "title")
    return folder


def sweep_rows() -> list[dict[str, Any]]:
    """Twelve combinations; each refiner multiplies the error by its EFFECT for every object and spacing."""
    rows = []
    for name, spacing, refiner in itertools.product(("pin", "hook"), (4.0, 6.0), SWEPT):
        error_mm = EFFECT[refiner] * (3.0 if name == "pin" else 7.0) * spacing
        rows.append({
            "object": name, "sensor": "gelslim", "renderer": "heightmap", "grid": "face", "encoder": "pixel",
            "matcher": "dense", "refiner": refiner, "fuser": "product", "noise": "strong", "seed": 0, "count": 5,
            "grid.spacing_mm": spacing, "grid_poses": 100, "best-1_median_mm": 2 * error_mm,
            "chosen_median_mm": error_mm, "chosen_mean_mm": error_mm, "coverage_80": 0.8, "total_ms": 10 / error_mm,
            "model_s": 1.0, "built": "[]", "error": "", "key": f"{len(rows):016x}",
        })  # fmt: skip
    return rows


def write_sweep(folder: Path, rows: list[dict[str, Any]] | None = None) -> Path:
    """Write sweep.json."""
    document = {
        "schema_version": 1, "created": "2026-01-01T00:00:00+00:00", "versions": {"numpy": "2"},
        "plan": {"count": 5, "refiner": list(SWEPT)}, "built": {"grid": 2, "bank": 2},
        "rows": sweep_rows() if rows is None else rows,
    }  # fmt: skip
    (folder / "sweep.json").write_text(json.dumps(document))
    return folder


def page_in(folder: Path) -> Page:
    return make_page(find_source(folder))


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
