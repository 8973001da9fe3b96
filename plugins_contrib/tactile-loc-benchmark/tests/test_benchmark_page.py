"""The report of a benchmark agrees with its rows."""

import json

import numpy as np
import pytest
from message_helpers import naming
from report_helpers import Elements
from tactile_loc import StageStore, TactileLocError
from tactile_loc.reports.page import Page, render

from tactile_loc_benchmark.files import read_benchmark, tabulate, tabulate_methods, tabulate_sources, write_benchmark
from tactile_loc_benchmark.page import make_benchmark_page, show_sources


@pytest.fixture(scope="module")
def page(finished, bench_store) -> Page:
    return make_benchmark_page(finished.results, list(show_sources(finished, StageStore(bench_store))))


@pytest.fixture(scope="module")
def elements(page) -> Elements:
    return Elements(render(page))


def test_the_page_shows_all_tables_and_failures(elements, finished):
    results = finished.results
    for row in (*tabulate(results.groups), *tabulate_sources(results), *tabulate_methods(results)):
        assert row in elements.rows
    assert ["archive", "brick", "oracle", finished.failed[0].error] in elements.rows


def test_scripts_draw_every_group_in_mm_and_percent(page, finished):
    groups = finished.results.groups
    drawn = page.data["groups"]
    assert len(drawn) == len(groups)
    for one, group in zip(drawn, groups, strict=True):
        assert (one["source"], one["method"], one["touches"]) == (group["source"], group["method"], group["touches"])
        assert one["within"] == pytest.approx(100 * np.array(group["within"]))
        assert len(one["errors_mm"]["first"]) == group["examples"]
        share = np.mean(np.array(one["errors_mm"]["first"]) < 1)
        assert share == pytest.approx(group["within"][1])
    json.dumps(page.data, allow_nan=False)


def test_the_files_make_the_same_page(page, finished, bench_store, tmp_path):
    write_benchmark(tmp_path, finished.results, list(show_sources(finished, StageStore(bench_store))))
    again = make_benchmark_page(*read_benchmark(tmp_path))
    assert render(again) == render(page)


@pytest.mark.parametrize(
    ("name", "content"),
    [("rows.parquet", None), ("rows.parquet", b"no table"), ("benchmark.json", b"{}"), ("benchmark.json", b"[1")],
)
def test_missing_or_damaged_files_are_refused(finished, tmp_path, name, content):
    write_benchmark(tmp_path, finished.results)
    (tmp_path / name).unlink()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(TactileLocError, match=naming(name)):
        read_benchmark(tmp_path)
