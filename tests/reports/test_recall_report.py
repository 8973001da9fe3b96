"""The page of an evaluation of what `run` answers agrees with its JSON."""

import json
import shutil
from pathlib import Path

import pytest
from report_helpers import Elements, html_of, make_recall_runs, page_in

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.summary import measure_recall
from tactile_loc.evaluation.table import ExampleTable, join_runs


@pytest.fixture
def folder(recall_folder) -> Path:
    return recall_folder


@pytest.fixture
def table() -> ExampleTable:
    return join_runs(make_recall_runs())


def test_the_page_shows_the_tables_of_the_file(folder, table):
    rows = Elements(html_of(folder)).rows
    for tabulate in (tables.tabulate_recall, tables.tabulate_verdicts, tables.tabulate_bins):
        for row in tabulate(tables.summarise_answers(table)):
            assert row in rows


def test_the_main_numbers_are_those_of_all_objects(folder, table):
    text = html_of(folder)
    for some in table.group("noise", "touches").values():
        share = f"{100 * measure_recall(some, [1e-3])[0]:.0f} %"
        assert f"<dd>{share}</dd>" in text


def test_scripts_draw_the_errors_of_every_example_in_mm(folder, table):
    drawn, groups = page_in(folder).data["groups"], tables.group_answers(table)
    assert [tuple(group[name] for name in tables.GROUP) for group in drawn] == list(groups)
    errors_mm = sorted(1e3 * next(iter(groups.values())).errors_m())
    assert drawn[0]["errors_mm"]["first"]["mssd"][:-1] == pytest.approx(errors_mm[:-1], rel=1e-4)
    assert drawn[0]["errors_mm"]["first"]["mssd"][-1] == 1e6  # without a pose


def test_examples_without_a_pose_are_listed_with_their_reason(folder):
    assert ["the file is damaged", "8"] in Elements(html_of(folder)).rows


def test_a_wrong_file_gives_a_one_sentence_error(recall_folder, tmp_path):
    folder = shutil.copytree(recall_folder, tmp_path / "copy")
    path = folder / "recall.json"
    document = json.loads(path.read_text())
    for changed, says in (
        ({"schema_version": 9}, "9"),
        *(({"runs": runs}, "run") for runs in ([], None)),
        ({"protocol": {}}, "'noises'"),
        ({"runs": [{"object": "a"}]}, "encoder"),
    ):
        path.write_text(json.dumps({**document, **changed}))
        with pytest.raises(ResultError, match=f"recall.json.*{says}"):
            page_in(folder)
