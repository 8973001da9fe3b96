"""The page of a benchmark in a browser without a network: its plots show the chosen groups."""

from collections.abc import Iterator
from typing import Any

import pytest
from browser_helpers import LOCAL, choose, list_errors, list_requests, open_browser, plots
from report_helpers import UNFRIENDLY
from tactile_loc.reports.report import write_page

from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.page import make_benchmark_page
from tactile_loc_benchmark.results import Results
from tactile_loc_benchmark.summary import WITHIN_M

PLOTS = {"success-plot", "curves-plot", "reliability-plot", "times-plot"}


@pytest.fixture(scope="module")
def results(run_small) -> Results:
    """Results of two sources, of which one has recorded touches, and of a method with an unfriendly name."""
    methods = ["oracle", {"name": "guess", "label": UNFRIENDLY}]
    return run_small(source=["sketch", "archive"], method=methods).results


@pytest.fixture
def page(results, tmp_path) -> Iterator[Any]:
    """The browser with the page; afterwards, check that there was no error and no request to a server."""
    with open_browser(1000, 900) as browser:
        browser.get(write_page(make_benchmark_page(results, []), tmp_path / "page.html").as_uri())
        yield browser
        assert list_errors(browser) == []
        assert [url for url in list_requests(browser) if not url.startswith(LOCAL)] == []


def read_traces(browser: Any, plot: str) -> list[dict[str, Any]]:
    """Return the names and values of a plot's traces."""
    script = "return document.getElementById(arguments[0]).data.map((t) => ({name: t.name, x: [...t.x], y: [...t.y]}))"
    return list(browser.execute_script(script, plot))


def select(results: Results, source: str, method: str) -> list[Row]:
    return [group for group in results.groups if (group["source"], group["method"]) == (source, method)]


@pytest.mark.slow
def test_the_plots_show_the_chosen_source_touches_and_distance(page, results):
    assert plots(page).keys() == PLOTS
    for within in (0, 3):
        choose(page, "within", str(within))
        oracle, guess = read_traces(page, "success-plot")
        for trace, method in ((oracle, "oracle"), (guess, UNFRIENDLY)):
            shares = [100 * group["within"][within] for group in select(results, "sketch", method)]
            assert trace["y"] == pytest.approx(shares)
        assert f"{1e3 * WITHIN_M[within]:g} mm" in page.execute_script(
            "return document.getElementById('success-plot').layout.yaxis.title.text"
        )
    assert oracle["y"] == [100, 100]
    for touches in (1, 2):
        choose(page, "touches", str(touches))
        _, stated = read_traces(page, "reliability-plot")
        assert (stated["name"], stated["x"], stated["y"]) == ("oracle", pytest.approx([75]), pytest.approx([100]))
        assert read_traces(page, "curves-plot")[0]["y"][-1] == 100
    choose(page, "source", "archive")
    choose(page, "touches", "1")
    for plot in PLOTS - {"reliability-plot"}:
        (trace,) = read_traces(page, plot)
        assert len(trace["y"]) > 0
    (guess,) = read_traces(page, "success-plot")
    assert guess["y"] == pytest.approx([100 * select(results, "archive", UNFRIENDLY)[0]["within"][3]])
    assert len(read_traces(page, "reliability-plot")) == 1, "only the line of calibrated probabilities"


@pytest.mark.slow
def test_the_recall_curve_counts_any_listed_pose_on_demand(page, results):
    def last_value(kind: str) -> float:
        choose(page, "kind", kind)
        trace = read_traces(page, "curves-plot")[0]
        near = [y for x, y in zip(trace["x"], trace["y"], strict=True) if x <= 1.0]
        return float(near[-1])

    choose(page, "touches", "1")
    (group,) = [one for one in select(results, "sketch", "oracle") if one["touches"] == 1]
    at_1_mm = WITHIN_M.index(1e-3)
    assert last_value("first") == pytest.approx(100 * group["within"][at_1_mm])
    assert last_value("listed") == pytest.approx(100 * group["listed_within"][at_1_mm])
