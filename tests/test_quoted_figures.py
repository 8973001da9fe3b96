"""The figures in the README and the documentation match the results files, and a wrong figure is reported."""

import re
from dataclasses import replace

import figures
import pytest
from figures import Quote, check_page, list_quotes, renew_tables
from results import ROOT, Kept, Results, Table, read_latest

TABLE = Table(["object", "median, ms", "error, mm"], [["pin", "56", "0.004 (0.1)"], ["hook", "101", "0.016 (0.2)"]])
PAGE = """# Benchmarks

## Tracking

Touches of a pin, 30 to 90 % deep.

<!-- results: slides 1 -->

| object | median, ms | error, mm |
|---|---|---|
| pin | 56 | 0.004 (0.1) |
| hook | 101 | 0.016 (0.2) |

A touch takes 56 to
101 ms. It was 200 ms before.
"""
TIMES = Quote("A touch takes {} to {} ms", lambda r: r.column("slides", 1, "median, ms"))
NAME = f"{figures.MARKED}tracking.md"
BESIDE = ["Touches of a pin, 30 to 90 % deep.", "It was 200 ms before."]


def kept(table=TABLE, beside=BESIDE):
    return Kept("sequences", [], "1", "2026-01-01", 1.0, 10.0, {}, {}, [table], "slides", beside=list(beside))


def told(text, run=None):
    return check_page(NAME, text, Results(slides=run or kept()), [TIMES])


def test_every_figure_in_the_documentation_matches_its_results():
    assert figures.find_problems() == []


@pytest.mark.parametrize("page", ["README.md", "docs/contacts.md", "docs/quickstart.md"])
def test_any_changed_figure_is_reported(page):
    results, quotes = read_latest(), list_quotes(page)
    text = (ROOT / page).read_text()
    quoted = [match.span(k + 1) for q in quotes for match in [q.find(text)] for k in range(len(match.groups()))]
    assert quoted
    for start, end in quoted:
        other = re.sub(r"\d", lambda digit: str((int(digit[0]) + 1) % 10), text[start:end])
        assert check_page(page, text[:start] + other + text[end:], results, quotes), text[start - 40 : end + 10]


def test_any_changed_table_is_restored():
    results = read_latest()
    pages = [text for name, text in figures.read_pages().items() if name.startswith(figures.MARKED)]
    tables = [(page, found.end()) for page in pages for found in figures.MARKER.finditer(page) if found["number"]]
    assert len(tables) > 40
    for page, end in tables:
        if (row := re.compile(r"(?<=\|---\|\n)\| [^\n]*\d").search(page, end)) is None:
            continue  # a table of words
        place = row.end() - 1  # the last digit of the first row
        text = page[:place] + str((int(page[place]) + 1) % 10) + page[place + 1 :]
        assert renew_tables(text, results) == page


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("| 56 |", "| 57 |", "differs from the results"),
        ("takes 56", "takes 57", "differs from the results"),
        ("A touch takes", "One touch takes", "has this text 0 times"),
        ("30 to 90 %", "20 to 90 %", "figures of slides that are not bound"),
        ("200 ms", "210 ms", "figures of slides that are not bound"),
        ("slides 1", "slides 2", "has 1 tables, and no number 2"),
        ("slides 1", "slides 1 | mass, g", "there is no column 'mass, g' among"),
        ("slides 1", "slide 1", "there is no run slide; there are slides"),
        ("<!-- results: slides 1 -->\n\n", "", "this table has no marker"),
        ("## Tracking", "Ten in 7 ms.\n\n## Tracking", "figures without results; quote them"),
    ],
)
def test_each_kind_of_difference_is_reported(before, after, said):
    assert before in PAGE
    assert told(PAGE) == []
    assert said in "\n".join(told(PAGE.replace(before, after)))


def test_a_new_measurement_renews_tables_and_lists_text_for_review():
    anew = kept(replace(TABLE, rows=[["pin", "60", "0.003 (0.1)"], ["hook", "1203", "0.016 (0.2)"]]), beside=[])
    text, failed = figures.renew_page(NAME, PAGE, Results(slides=anew), [TIMES])
    assert failed == []
    assert "| pin | 60 | 0.003 (0.1) |\n| hook | 1203 | 0.016 (0.2) |\n\nA touch takes 60 to\n1203 ms." in text
    (problem,) = told(text, anew)
    assert problem.endswith("bench.py bind slides:\n  Tracking: " + "\n  Tracking: ".join(BESIDE))
    assert told(text, replace(anew, beside=BESIDE)) == []


def test_reviewed_text_is_bound_to_the_results(tmp_path, monkeypatch):
    page = tmp_path / NAME
    page.parent.mkdir(parents=True)
    page.write_text(PAGE)
    kept(beside=[]).write(tmp_path)
    monkeypatch.setattr(figures, "list_quotes", lambda page: [TIMES])
    figures.bind("slides", tmp_path, tmp_path)
    assert read_latest(tmp_path)["slides"].beside == BESIDE
    with pytest.raises(SystemExit, match="there is no run others; there are slides"):
        figures.bind("others", tmp_path, tmp_path)
