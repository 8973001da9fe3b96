"""The pages of evaluations agree with their JSON."""

import json
import shutil

import pytest
from report_helpers import Elements, html_of, page_in

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.evaluation.paper import tables as paper_tables
from tactile_loc.evaluation.table import ExampleTable


@pytest.fixture(scope="module")
def document(evaluation_folder) -> dict:
    return json.loads((evaluation_folder / "results.json").read_text())


@pytest.fixture(scope="module")
def page(evaluation_folder) -> Elements:
    return Elements(html_of(evaluation_folder))


def test_the_page_shows_the_tables_of_the_file(document, page):
    lines, runs = document["summary"], document["runs"]
    tables = [
        paper_tables.tabulate_medians(lines, paper_tables.format_median),
        paper_tables.tabulate_medians(lines, paper_tables.format_share_of_random),
        paper_tables.tabulate_posteriors(runs),
        paper_tables.tabulate_times(runs),
    ]
    assert page.rows[: sum(map(len, tables))] == [row for table in tables for row in table]


def test_scripts_draw_every_touch_s_errors_in_mm(document, evaluation_folder):
    data = page_in(evaluation_folder).data
    tables = ExampleTable.read(document["examples"]).group("object")
    for drawn, run in zip(data["runs"], document["runs"], strict=True):
        table = tables[run["object"],]
        for line, by_metric in drawn["errors_mm"].items():
            for metric, errors_mm in by_metric.items():
                assert errors_mm == pytest.approx(1e3 * table.errors_m(line, metric), rel=1e-5)
        assert drawn["entropy"] == pytest.approx(table["entropy_nats"], rel=1e-5)
        assert drawn["random_mm"]["add"] == pytest.approx(1e3 * run["random_mean_m"]["add"])


def test_the_page_contains_the_gallery_as_a_small_image(page):
    (image,) = page.named("img")
    assert str(image["src"]).startswith("data:image/png;base64,")
    assert len(str(image["src"])) < 20_000
    assert "pin" in str(image["alt"])


def test_the_page_shows_the_contacts_of_the_file(contacts_folder):
    rows = json.loads((contacts_folder / "contacts.json").read_text())["summary"]
    page = Elements(html_of(contacts_folder))
    table = paper_tables.tabulate_contacts(rows)
    assert page.rows[: len(table)] == table
    drawn = page_in(contacts_folder).data["runs"][0]["lines"]["best-1"]
    assert drawn["contacts"] == [1, 2, 5]
    assert drawn["metres"]["q75"] == pytest.approx([1e3 * row["q75_m"] for row in rows if row["line"] == "best-1"])
    assert ["pin", "pixel", "0", "0", "4"] in page.rows  # without a common pose


@pytest.mark.parametrize("fixture", ["evaluation_folder", "contacts_folder", "recall_folder"])
def test_a_wrong_file_gives_a_one_sentence_error(fixture, request, tmp_path):
    folder = shutil.copytree(request.getfixturevalue(fixture), tmp_path / "copy")
    (path,) = (path for path in folder.glob("*.json"))
    document = json.loads(path.read_text())
    for changed, says in (
        ({"schema_version": 9}, "9"),
        *(({"runs": runs}, "run") for runs in ([], None)),
        ({"protocol": {}}, "'(touches|examples|noises)'"),
        ({"runs": [{"object": "a"}]}, "encoder"),
    ):
        path.write_text(json.dumps({**document, **changed}))
        with pytest.raises(ResultError, match=f"{path.name}.*{says}"):
            page_in(folder)


def test_a_damaged_gallery_is_omitted(evaluation_folder, tmp_path):
    folder = shutil.copytree(evaluation_folder, tmp_path / "copy")
    (picture,) = folder.glob("gallery-*.png")
    content = picture.read_bytes()
    picture.write_bytes(content[:33] + bytes(8) + content[41:])  # the second part's length and kind
    assert 'id="part-gallery"' in html_of(evaluation_folder)
    assert 'id="part-gallery"' not in html_of(folder)
