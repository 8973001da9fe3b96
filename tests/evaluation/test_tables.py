"""The tables of an evaluation agree in Markdown, CSV and JSON."""

from __future__ import annotations

import csv
import dataclasses
import io
import json

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.metrics import POSTERIOR_METRICS
from tactile_loc.evaluation.protocol import LINES, METRICS, STAGES, Evaluation
from tactile_loc.evaluation.tables import (
    Run,
    format_csv,
    format_markdown,
    record_runs,
    tabulate_ambiguity,
    tabulate_areas,
    tabulate_medians,
    tabulate_posteriors,
    write_tables,
)

PROTOCOL = {"touches": 12, "noise": "mild", "seed": 1}


def make_run(name: str, encoder: str, seed: int) -> Run:
    rng = np.random.default_rng(seed)
    errors = rng.uniform(1e-4, 3e-2, (12, len(LINES), len(METRICS)))
    poses = np.broadcast_to(np.eye(4), (12, len(LINES), 4, 4))
    seconds, posterior_metrics = (
        rng.uniform(0, 0.01, (12, len(STAGES))),
        rng.uniform(0, 1, (12, len(POSTERIOR_METRICS))),
    )
    return Run(
        name,
        "z2",
        encoder,
        500,
        Evaluation(errors, poses, seconds, posterior_metrics, *rng.uniform(0, (3, 0.2), (12, 2)).T, np.arange(12)),
    )


def test_posterior_metrics_agree_in_table_and_json(runs):
    trust, (header, row, *_) = runs[0].summarise_posteriors(), tabulate_posteriors(runs)
    held = runs[0].evaluation.posterior_metrics[:, POSTERIOR_METRICS.index("credible_level")] <= 0.8
    assert trust.coverage[1] == held.mean()
    assert row[3] == f"{100 * held.mean():.0f} %"
    assert float(row[-1]) == pytest.approx(1e3 * trust.spread_m, rel=0.01)
    assert dict(zip(header, row, strict=True))["uniform"] == f"{np.log(500):.2f}"
    found = record_runs(runs, PROTOCOL)["runs"][0]
    assert found["posterior"]["coverage"] == trust.coverage
    assert found["posterior_metrics"]["nll"] == runs[0].evaluation.posterior_metrics[:, 0].tolist()
    assert " | ".join(row) in format_markdown(runs, "title")


def test_ambiguous_touches_are_counted_and_left_out(runs):
    run, found = runs[0], record_runs(runs, PROTOCOL)["runs"][0]
    ratios = np.array(found["ambiguity_ratios"])
    clear = np.array(found["errors_m"]["chosen"]["add"])[ratios >= 1]
    assert 0 < len(clear) < len(ratios)
    assert found["ambiguity"]["ambiguous"] == (ratios < 1).mean()
    assert found["ambiguity"]["unambiguous"]["chosen"]["median"] == np.median(clear)
    row = dict(zip(*tabulate_ambiguity(runs)[:2], strict=True))
    assert row["ambiguous"] == f"{100 * (ratios < 1).mean():.0f} %"
    assert row["chosen, all"] == format_mm(run.summarise("chosen").median)
    assert row["chosen, unambiguous"] == format_mm(np.median(clear))
    assert " | ".join(row.values()) in format_markdown(runs, "title")


def test_errors_are_grouped_by_contact_area(runs):
    (found, *_) = record_runs(runs, PROTOCOL)["runs"]
    shares, errors = np.array(found["contact_shares"]), np.array(found["errors_m"]["chosen"]["add"])
    assert sum(area["touches"] for area in found["contact_areas"]) == len(shares)
    assert found["refused"] == sum(range(12))
    few = found["contact_areas"][3]
    some = errors[(shares >= 0.05) & (shares < 0.15)]
    assert (few["from"], few["to"], few["touches"]) == (0.05, 0.15, len(some))
    assert few["median_m"] == np.median(some)
    assert few["within_1_mm"] == (some < 1e-3).mean()
    row = dict(zip(*tabulate_areas(runs)[:2], strict=True))
    assert row["5 to 15 %"] == f"{format_mm(np.median(some))}, {100 * few['within_1_mm']:.0f} % ({len(some)})"
    assert row["refused"] == "66"
    assert " | ".join(row.values()) in format_markdown(runs, "title")


def test_full_contact_counts_in_the_last_area_and_empty_areas_show_a_dash():
    run = make_run("pin", "pixel", 0)
    full = dataclasses.replace(run, evaluation=dataclasses.replace(run.evaluation, contact_share=np.ones(12)))
    *others, last = tabulate_areas([full])[1][3:]
    assert set(others) == {"-"}
    assert last.endswith("(12)")
    assert json.loads(json.dumps(record_runs([full], PROTOCOL)))["runs"][0]["contact_areas"][0]["median_m"] is None


def test_an_empty_group_shows_a_dash_and_json_has_no_infinity():
    run = make_run("pin", "pixel", 0)
    for ratio, shown in ((0.0, "-"), (np.inf, format_mm(run.summarise("chosen").median))):
        evaluation = dataclasses.replace(run.evaluation, ambiguity=np.full(12, ratio))
        one = dataclasses.replace(run, evaluation=evaluation)
        assert tabulate_ambiguity([one])[1][-1] == shown
        found = json.loads(json.dumps(record_runs([one], PROTOCOL), allow_nan=False))["runs"][0]
        assert (found["ambiguity"]["unambiguous"]["chosen"] is None) == (ratio == 0)
        assert (found["ambiguity_ratios"][0] is None) == (ratio > 0)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return [make_run(name, encoder, i) for i, name in enumerate(("pin", "hook")) for encoder in ("pixel", "other")]


def test_csv_json_and_markdown_agree(runs):
    rows = list(csv.DictReader(io.StringIO(format_csv(runs))))
    assert len(rows) == len(runs) * len(LINES) * len(METRICS)
    found = json.loads(json.dumps(record_runs(runs, PROTOCOL)))["runs"]
    by_name = {(run["object"], run["encoder"]): run for run in found}
    sections = {part.split("\n")[0]: part for part in format_markdown(runs, "title").split("\n## ")[1:]}
    for row in rows:
        entry = by_name[row["object"], row["encoder"]]["lines"][row["line"]][row["metric"]]
        for statistic in ("mean", "median", "std", "q25", "q75", "p90"):
            assert float(row[f"{statistic}_mm"]) == pytest.approx(1e3 * entry["metres"][statistic], rel=1e-5)
            assert float(row[f"{statistic}_normalised"]) == pytest.approx(entry["normalised"][statistic], rel=1e-5)
        if row["metric"] == "add":
            section = sections[f"{row['object']}, {row['encoder']}"]
            (line,) = [text for text in section.splitlines() if text.startswith(f"| {row['line']} |")]
            cells = [cell.strip() for cell in line.split("|")[1:-1]]
            assert cells[1] == format_mm(1e-3 * float(row["median_mm"]))
            assert cells[2] == format_mm(1e-3 * float(row["mean_mm"]))
            assert cells[6] == f"{float(row['median_normalised']):.3f}"


def test_statistics_equal_those_of_the_touches(runs):
    (run, *_) = record_runs(runs, PROTOCOL)["runs"]
    for line in LINES:
        for metric in METRICS:
            errors = np.array(run["errors_m"][line][metric])
            entry = run["lines"][line][metric]
            assert entry["metres"]["median"] == pytest.approx(np.median(errors))
            scale = run["random_mean_m"][metric]
            assert entry["normalised"]["p90"] == pytest.approx(np.quantile(errors, 0.9) / scale)
    assert run["lines"]["random"]["add"]["normalised"]["mean"] == pytest.approx(1)


def test_the_summary_has_a_cell_for_each_column(runs):
    header, *rows = tabulate_medians(runs)
    assert [row[:2] for row in rows] == [[run.object, run.encoder] for run in runs]
    assert {len(row) for row in rows} == {len(header)}
    assert rows[0][2] == format_mm(runs[0].summarise("best-1").median)
    assert f"{rows[0][2]} ({tabulate_medians(runs, normalised=True)[1][2]})" in format_markdown(runs, "title")


def test_files_are_written_whole_or_refused(runs, tmp_path):
    written = write_tables(tmp_path / "out", runs, PROTOCOL, "title")
    assert [path.name for path in written] == ["results.json", "results.csv", "results.md"]
    assert json.loads(written[0].read_text())["protocol"]["noise"] == "mild"
    assert written[1].read_text() == format_csv(runs)
    assert written[2].read_text() == format_markdown(runs, "title")
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="`out`"):
        write_tables(tmp_path / "file", runs, PROTOCOL, "title")
