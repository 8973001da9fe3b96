"""The figures in the README and the documentation match the results files, and a wrong figure is reported."""

import re
from dataclasses import replace

import figures
import pytest
from figures import Quote, check_page, find_sentences, find_unmarked, format_figure, list_quotes, renew_tables
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
        place = re.compile(r"(?<=\|---\|\n)\| [^\n]*\d").search(page, end).end() - 1  # the last digit of its first row
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


def test_a_marker_selects_columns_of_a_table():
    marker = "<!-- results: slides 1 | error, mm | object -->\n"
    shown = renew_tables(marker, Results(slides=kept()))
    assert shown == f"{marker}\n| error, mm | object |\n|---|---|\n| 0.004 (0.1) | pin |\n| 0.016 (0.2) | hook |\n"
    assert renew_tables(shown, Results(slides=kept())) == shown
    assert renew_tables(f"{marker}\nText.\n", Results(slides=kept())) == f"{shown}\nText.\n"
    assert renew_tables("<!-- results: slides -->\nText.\n", Results()) == "<!-- results: slides -->\nText.\n"


@pytest.mark.parametrize(
    ("value", "before", "after"),
    [
        (0.104, "0.10", "0.10"), (0.106, "0.10", "0.11"), (12.5, "12", "12"), (12.5, "13", "13"), (12.6, "12", "13"),
        (11482, "11 000", "11 482"), (11000, "11 000", "11 000"), (9000, "11 000", "9000"), (1.5, "+1.2", "+1.5"),
        (-1.5, "+1.2", "-1.5"), (11000, "9000", "11 000"),
    ],
)  # fmt: skip
def test_a_figure_keeps_the_format_of_the_previous_one(value, before, after):
    assert format_figure(value, before) == after


def test_sentences_with_figures_belong_to_their_marker():
    text = """# A

At 3 mm. `at 4 mm`, and so on.
```
| 5 mm |
# 6 mm
```

<!-- results: one 1 -->

| 1 mm |
|---|

- It took 7 s ([how](page.md#8-s)). Then 9 of
  10 were there.

<!-- results: two -->

At 11.5, no more.

## B

At 2 GB."""
    found = [(one.section, one.run, one.text) for one in find_sentences(text, [])]
    assert found == [
        ("A", "one", "At 3 mm."),
        ("A", "one", "- It took 7 s ([how])."),
        ("A", "one", "Then 9 of 10 were there."),
        ("A", "two", "At 11.5, no more."),
        ("B", "", "At 2 GB."),
    ]
    assert find_unmarked(text) == []


def test_missing_values_and_missing_rows_are_reported():
    few = replace(TIMES, values=lambda r: [1.0])
    lost = replace(TIMES, values=lambda r: [*r.at("slides", 1, "median, ms", "head"), 1.0])
    for quote, said in ((few, "1 values for 2 figures"), (lost, "no row of the table begins with ('head',)")):
        assert said in "\n".join(check_page(NAME, PAGE, Results(slides=kept()), [quote]))
