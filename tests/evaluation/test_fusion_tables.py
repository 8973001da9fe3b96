"""Tables of several contacts hold the numbers of the errors."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest
from message_helpers import missing

from tactile_loc.evaluation.fusion import FUSION_LINES, FusionEvaluation
from tactile_loc.evaluation.fusion_tables import (
    FusionRun,
    format_csv,
    format_markdown,
    tabulate_medians,
    write_fusion_tables,
)

CONTACTS = (1, 2, 5)


def make_contact_run(name: str, encoder: str, seed: int) -> FusionRun:
    """A run of 40 examples whose errors fall with the number of contacts."""
    rng = np.random.default_rng(seed)
    scales = 1e-3 * np.array([[20, 40, 40], [5, 30, 40], [2, 15, 40]])
    alone = np.zeros((40, 3, 2), bool)
    alone[:4, 2] = True
    found = FusionEvaluation(CONTACTS, scales * rng.uniform(0.5, 1.5, (40, 3, 3)), alone, np.full(40, 2))
    return FusionRun(name, "none", encoder, 1000, found, {"grid": {"name": "face"}})


@pytest.fixture(scope="module")
def run() -> FusionRun:
    return make_contact_run("pin", "pixel", 0)


def test_rows_have_the_medians_by_number_of_contacts(run):
    header, best, kinematic = tabulate_medians([run])
    assert header == ["object", "encoder", "line", "1 contact", "2 contacts", "5 contacts"]
    assert (best[:3], kinematic[:3]) == (["pin", "pixel", "best-1"], ["pin", "pixel", "kinematic"])
    medians = [1e3 * np.median(run.evaluation.select_errors("best-1", n)) for n in CONTACTS]
    assert [float(cell) for cell in best[3:]] == pytest.approx(medians, rel=6e-3)
    shares = [float(cell) for cell in tabulate_medians([run], normalised=True)[1][3:]]
    assert shares == pytest.approx([m / (1e3 * run.evaluation.compute_scale_m()) for m in medians], abs=6e-4)


def test_csv_has_mean_median_and_spread_in_mm_and_normalised(run):
    rows = list(csv.DictReader(io.StringIO(format_csv([run]))))
    assert len(rows) == 2 * len(CONTACTS)
    row = next(r for r in rows if (r["line"], r["contacts"]) == ("kinematic", "5"))
    errors = run.evaluation.select_errors("kinematic", 5)
    for name, value in (("mean", errors.mean()), ("median", np.median(errors)), ("std", errors.std())):
        assert float(row[f"{name}_mm"]) == pytest.approx(1e3 * value, rel=1e-4)
        assert float(row[f"{name}_normalised"]) == pytest.approx(value / run.evaluation.compute_scale_m(), rel=1e-4)
    assert row["without_common"] == "4"


def test_files_are_written(run, tmp_path):
    written = write_fusion_tables(tmp_path, [run, make_contact_run("hook", "pixel", 1)], {"examples": 40}, "Title")
    assert [path.name for path in written] == ["contacts.json", "contacts.csv", "contacts.md"]
    record = json.loads(written[0].read_text())
    assert record["protocol"]["contacts"] == [1, 2, 5]
    first = record["runs"][0]
    assert set(first["lines"]) == set(FUSION_LINES)
    best = first["lines"]["best-1"][2]
    assert (best["contacts"], best["without_common"]) == (5, 4)
    assert first["refused"] == 80
    assert np.median(best["errors_m"]) == pytest.approx(best["metres"]["median"])
    assert written[2].read_text() == format_markdown([run, make_contact_run("hook", "pixel", 1)], "Title")


def test_markdown_counts_the_examples_without_a_common_pose(run):
    text = format_markdown([run], "Title")
    assert text.startswith("# Title\n")
    assert not missing(text, "common", 80)
    assert next(line for line in text.splitlines() if line.startswith("| best-1 | 5 |")).endswith("| 4 |")
