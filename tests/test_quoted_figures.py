"""The figures of the README and the documentation are those of the results files, and whichever drifts is told."""

import re
from dataclasses import replace

import figures
import pytest
from figures import Quote, checked, quotes_of, sentences, unmarked, with_tables, written
from results import ROOT, Kept, Results, Table, latest

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
    return checked(NAME, text, Results(slides=run or kept()), [TIMES])


def test_every_figure_of_the_documentation_is_that_of_its_results():
    assert figures.problems() == []


@pytest.mark.parametrize("page", ["README.md", "docs/contacts.md", "docs/quickstart.md"])
def test_whichever_figure_is_changed_is_told(page):
    results, quotes = latest(), quotes_of(page)
    text = (ROOT / page).read_text()
    quoted = [match.span(k + 1) for q in quotes for match in [q.found(text)] for k in range(len(match.groups()))]
    assert quoted
    for start, end in quoted:
        other = re.sub(r"\d", lambda digit: str((int(digit[0]) + 1) % 10), text[start:end])
        assert checked(page, text[:start] + other + text[end:], results, quotes), text[start - 40 : end + 10]


def test_whichever_table_is_changed_is_told():
    results, pages = latest(), [text for name, text in figures.pages().items() if name.startswith(figures.MARKED)]
    tables = [(page, found.end()) for page in pages for found in figures.MARKER.finditer(page) if found["number"]]
    assert len(tables) > 40
    for page, end in tables:
        place = re.compile(r"(?<=\|---\|\n)\| [^\n]*\d").search(page, end).end() - 1  # the last digit of its first row
        text = page[:place] + str((int(page[place]) + 1) % 10) + page[place + 1 :]
        assert with_tables(text, results) == page


def test_a_page_that_is_as_kept_has_no_problem():
    assert told(PAGE) == []


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("| 56 |", "| 57 |", "differs from the results"),
        ("takes 56", "takes 57", "differs from the results"),
        ("A touch takes", "One touch takes", "should say so once, and does 0 times"),
        ("30 to 90 %", "20 to 90 %", "what its results do not have"),
        ("200 ms", "210 ms", "what its results do not have"),
        ("slides 1", "slides 2", "has 1 tables, and no number 2"),
        ("slides 1", "slides 1 | mass, g", "there is no column 'mass, g' among"),
        ("slides 1", "slide 1", "there is no run slide; there are slides"),
        ("<!-- results: slides 1 -->\n\n", "", "this table follows no marker"),
        ("## Tracking", "Ten in 7 ms.\n\n## Tracking", "figures of no results; quote them"),
    ],
)
def test_what_drifts_is_told(before, after, said):
    assert before in PAGE
    assert said in "\n".join(told(PAGE.replace(before, after)))


def test_a_measurement_renews_tables_and_quotes_and_leaves_the_text_to_be_looked_over():
    anew = kept(replace(TABLE, rows=[["pin", "60", "0.003 (0.1)"], ["hook", "1203", "0.016 (0.2)"]]), beside=[])
    text, failed = figures.renewed(NAME, PAGE, Results(slides=anew), [TIMES])
    assert failed == []
    assert "| pin | 60 | 0.003 (0.1) |\n| hook | 1203 | 0.016 (0.2) |\n\nA touch takes 60 to\n1203 ms." in text
    (problem,) = told(text, anew)
    assert problem.endswith("bench.py bind slides:\n  Tracking: " + "\n  Tracking: ".join(BESIDE))
    assert told(text, replace(anew, beside=BESIDE)) == []


def test_what_was_looked_over_is_bound(tmp_path, monkeypatch):
    page = tmp_path / NAME
    page.parent.mkdir(parents=True)
    page.write_text(PAGE)
    kept(beside=[]).write(tmp_path)
    monkeypatch.setattr(figures, "quotes_of", lambda page: [TIMES])
    figures.bind("slides", tmp_path, tmp_path)
    assert latest(tmp_path)["slides"].beside == BESIDE
    with pytest.raises(SystemExit, match="there is no run others; there are slides"):
        figures.bind("others", tmp_path, tmp_path)


def test_some_columns_of_a_table_can_be_shown():
    marker = "<!-- results: slides 1 | error, mm | object -->\n"
    shown = with_tables(marker, Results(slides=kept()))
    assert shown == f"{marker}\n| error, mm | object |\n|---|---|\n| 0.004 (0.1) | pin |\n| 0.016 (0.2) | hook |\n"
    assert with_tables(shown, Results(slides=kept())) == shown
    assert with_tables("<!-- results: slides -->\nText.\n", Results()) == "<!-- results: slides -->\nText.\n"


@pytest.mark.parametrize(
    ("value", "before", "after"),
    [
        (0.104, "0.10", "0.10"), (0.106, "0.10", "0.11"), (12.5, "12", "12"), (12.5, "13", "13"), (12.6, "12", "13"),
        (11482, "11 000", "11 482"), (11000, "11 000", "11 000"), (9000, "11 000", "9000"), (1.5, "+1.2", "+1.5"),
        (-1.5, "+1.2", "-1.5"), (11000, "9000", "11 000"),
    ],
)  # fmt: skip
def test_a_figure_is_written_as_the_one_before(value, before, after):
    assert written(value, before) == after


def test_code_has_no_figures_and_sentences_follow_their_markers():
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
    found = [(one.section, one.run, one.text) for one in sentences(text, [])]
    assert found == [
        ("A", "one", "At 3 mm."),
        ("A", "one", "- It took 7 s ([how])."),
        ("A", "one", "Then 9 of 10 were there."),
        ("A", "two", "At 11.5, no more."),
        ("B", "", "At 2 GB."),
    ]
    assert unmarked(text) == []


def test_a_quote_of_too_few_values_and_a_table_without_the_row_are_told():
    few = replace(TIMES, values=lambda r: [1.0])
    lost = replace(TIMES, values=lambda r: [*r.at("slides", 1, "median, ms", "head"), 1.0])
    for quote, said in ((few, "1 values are given"), (lost, "no row of the table begins with ('head',)")):
        assert said in "\n".join(checked(NAME, PAGE, Results(slides=kept()), [quote]))
