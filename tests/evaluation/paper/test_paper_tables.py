"""The tables of the paper's protocol agree in Markdown, CSV and JSON."""

import csv
import io
import json

import numpy as np
import pytest
from message_helpers import missing
from report_helpers import CONTACTS, make_contact_table, make_touch_table

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.paper import tables as paper_tables
from tactile_loc.evaluation.paper.fusion import FUSED_LINES, FUSION_LINES
from tactile_loc.evaluation.protocol import LINES
from tactile_loc.evaluation.summary import summarise_lines
from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable

PROTOCOL = {"touches": 12, "noise": "mild", "seed": 1}


@pytest.fixture(scope="module")
def runs() -> list[EvaluatedRun]:
    names = [(name, encoder, i) for i, name in enumerate(("pin", "hook")) for encoder in ("pixel", "other")]
    return [EvaluatedRun(make_touch_table(*about)) for about in names]


@pytest.fixture(scope="module")
def written(runs, tmp_path_factory) -> dict[str, str]:
    """The texts of the files, by suffix."""
    paths = paper_tables.collect_touches(runs, PROTOCOL, "title").write(tmp_path_factory.mktemp("out"))
    assert [path.name for path in paths] == ["results.json", "results.csv", "results.md"]
    return {path.suffix: path.read_text() for path in paths}


@pytest.fixture(scope="module")
def document(written) -> dict:
    return json.loads(written[".json"])


def first_row(table: list[list[str]]) -> dict[str, str]:
    return dict(zip(*table[:2], strict=True))


def test_csv_json_and_markdown_agree(runs, written, document):
    rows = list(csv.DictReader(io.StringIO(written[".csv"])))
    assert len(rows) == len(runs) * len(LINES) == len(document["summary"])
    sections = {part.split("\n")[0]: part for part in written[".md"].split("\n## ")[1:]}
    for row, entry in zip(rows, document["summary"], strict=True):
        assert [row[name] for name in ("object", "encoder", "line")] == list(entry.values())[:3]
        for statistic in ("mean", "median", "std", "q25", "q75", "p90"):
            assert float(row[f"{statistic}_mm"]) == pytest.approx(1e3 * entry[f"{statistic}_m"], rel=1e-5)
            assert float(row[f"{statistic}_normalised"]) == pytest.approx(entry[f"{statistic}_normalised"], rel=1e-5)
        section = sections[f"{row['object']}, {row['encoder']}"]
        (line,) = [text for text in section.splitlines() if text.startswith(f"| {row['line']} |")]
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        assert cells[1] == format_mm(1e-3 * float(row["median_mm"]))
        assert cells[2] == format_mm(1e-3 * float(row["mean_mm"]))
        assert cells[6] == f"{float(row['median_normalised']):.3f}"
        assert "66 presses" in section


def test_statistics_equal_those_of_the_touches(runs, document):
    read = ExampleTable.read(document["examples"]).group("object", "encoder")["pin", "pixel"]
    for row in document["summary"][: len(LINES)]:
        errors_m = runs[0].table.errors_m(row["line"], "add")
        assert (read.errors_m(row["line"], "add") == errors_m).all()
        assert row["median_m"] == pytest.approx(np.median(errors_m))
        scale_m = document["runs"][0]["random_mean_m"]
        assert row["p90_normalised"] == pytest.approx(np.quantile(errors_m, 0.9) / scale_m)
        if row["line"] == "random":
            assert row["mean_normalised"] == pytest.approx(1)


def test_posterior_metrics_agree_in_table_and_json(runs, written, document):
    row = first_row(paper_tables.tabulate_posteriors(document["runs"]))
    held = (runs[0].table["credible_level"] <= 0.8).mean()
    assert document["runs"][0]["coverage"][1] == held
    assert row["in the 80 % set"] == f"{100 * held:.0f} %"
    assert row["spread, mm"] == format_mm(runs[0].table["spread_m"].mean())
    assert row["uniform"] == f"{np.log(500):.2f}"
    assert " | ".join(row.values()) in written[".md"]


# ---- by number of contacts


def test_contacts_have_their_medians_in_every_file(tmp_path):
    tables = [make_contact_table("pin", "pixel", 0), make_contact_table("hook", "pixel", 1)]
    written = paper_tables.collect_contacts(list(map(EvaluatedRun, tables)), {"examples": 40}, "Title").write(tmp_path)
    assert [path.name for path in written] == ["contacts.json", "contacts.csv", "contacts.md"]
    table, (document, rows, text) = tables[0], (path.read_text() for path in written)
    header, best, _, kinematic, *_ = paper_tables.tabulate_contacts(summarise_lines(table, FUSED_LINES))
    assert header == ["object", "encoder", "line", "1 contact", "2 contacts", "5 contacts"]
    assert (best[:3], kinematic[:3]) == (["pin", "pixel", "best-1"], ["pin", "pixel", "kinematic"])
    scale_m = table.errors_m("random", "add").mean()
    for cell, n in zip(best[3:], CONTACTS, strict=True):
        median_m = np.median(table.group("touches")[n,].errors_m("best-1", "add"))
        assert cell == f"{format_mm(median_m)} ({median_m / scale_m:.3f})"
    row = next(r for r in csv.DictReader(io.StringIO(rows)) if (r["line"], r["contacts"]) == ("kinematic", "5"))
    errors_m = table.group("touches")[5,].errors_m("kinematic", "add")
    for name, value in (("mean", errors_m.mean()), ("median", np.median(errors_m)), ("std", errors_m.std())):
        assert float(row[f"{name}_mm"]) == pytest.approx(1e3 * value, rel=1e-4)
        assert float(row[f"{name}_normalised"]) == pytest.approx(value / scale_m, rel=1e-4)
    assert row["without_common"] == "4"
    record = json.loads(document)
    assert record["protocol"]["contacts"] == [1, 2, 5]
    assert {entry["line"] for entry in record["summary"]} == set(FUSION_LINES)
    assert record["runs"][0]["refused"] == 80
    assert text.startswith("# Title\n")
    assert not missing(text, "common", 80)
    assert next(line for line in text.splitlines() if line.startswith("| best-1 | 5 |")).endswith("| 4 |")


# ---- beside the paper


def test_the_papers_numbers_stand_beside_those_of_its_objects(tmp_path):
    """A mesh file of the same name is another object."""
    paths = {"elbow_pipe": "elbow_pipe", "pin": "parts/pin.stl"}
    runs, contacts = (
        [EvaluatedRun(make(name, "pixel", 0), {"object": {"path": path}}) for name, path in paths.items()]
        for make in (make_touch_table, make_contact_table)
    )
    found = paper_tables.collect_paper(runs, contacts, {"quick": ["few"]}, "Title")
    document, rows, text = (path.read_text() for path in found.write(tmp_path))
    one_touch, by_contacts = (table for _, _, table in found.tables)
    assert [line[0:3:2] for line in one_touch[1:]] == [
        ["elbow_pipe", "measured"], ["elbow_pipe", "paper"], ["pin", "measured"]
    ]  # fmt: skip
    paper = dict(zip(one_touch[0], one_touch[2], strict=True))
    assert [paper[line] for line in ("best-1", "best-10", "best-50", "reg-1")] == ["0.87", "0.26", "0.08", "-"]
    assert {line[2] for line in by_contacts[1:]} == {"best-1", "reg-1", "kinematic"}
    first = json.loads(document)["summary"][0]
    assert first["published_median_normalised"] == 0.87
    assert one_touch[1][3] == f"{first['median_normalised']:.3f}"
    assert len(list(csv.DictReader(io.StringIO(rows)))) == 2 * (len(paper_tables.PAPER_LINES) + 3 * len(CONTACTS))
    assert " | ".join(one_touch[2]) in text
