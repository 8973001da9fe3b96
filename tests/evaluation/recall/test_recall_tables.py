"""The tables and the JSON document of an evaluation agree with its results."""

import csv
import json

import pytest
from report_helpers import make_recall_runs

from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable, join_runs

ABOUT = {"examples": 12, "noises": ["none", "strong"], "seeds": [5]}


@pytest.fixture
def runs() -> list[EvaluatedRun]:
    return make_recall_runs()


@pytest.fixture
def table(runs) -> ExampleTable:
    return join_runs(runs)


def test_groups_join_seeds_and_then_all_objects(runs):
    groups = tables.group_answers(join_runs([*runs, runs[0]]))  # as a second seed
    labels = [(name, noise, touches, len(some)) for (name, _, noise, touches), some in groups.items()]
    assert labels[:2] == [("pin", "none", 1, 24), ("pin", "none", 3, 24)]
    noises = (("none", 36), ("strong", 24))
    assert labels[-4:] == [("all", noise, touches, count) for noise, count in noises for touches in (1, 3)]
    assert {name for name, *_ in tables.group_answers(join_runs(runs[:2]))} == {"pin"}


def test_the_csv_has_a_row_for_each_group(runs, table, tmp_path):
    tables.collect_answers(runs, ABOUT, "title").write(tmp_path)
    rows = list(csv.DictReader((tmp_path / "recall.csv").read_text().splitlines()))
    found = tables.summarise_answers(table)
    assert [[row[name] for name in tables.GROUP] for row in rows] == [
        [str(one[name]) for name in tables.GROUP] for one in found
    ]
    assert float(rows[0]["within_1_mm"]) == pytest.approx(found[0]["within"][1], rel=1e-5)


def test_the_document_has_every_example_and_is_read_back(runs, table):
    document = json.loads(json.dumps(tables.collect_answers(runs, ABOUT, "").document, allow_nan=False))
    assert document["examples"]["first mssd_m"][2] is None
    assert document["examples"]["problem"][2] == "the file is damaged"
    assert document["runs"][0]["refused"] == 12
    assert tables.summarise_answers(ExampleTable.read(document["examples"])) == tables.summarise_answers(table)


def test_problems_are_counted_not_dropped(runs, table):
    assert tables.list_problems(table) == [("the file is damaged", 2 * len(runs))]
    assert "the file is damaged" in tables.collect_answers(runs, ABOUT, "title").format_markdown()
