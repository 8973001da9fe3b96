"""The figures of the documentation: each comes from a results file, and is compared with it.

A table follows a marker that names a run, which of its tables it is, and, if not all are shown, the columns:
`<!-- results: search 1 | object | build, s -->`. What a text says is either computed from tables, by the quotes of
`quotes.py`, or bound to the run whose marker is nearest above it in its section, or whose table is first in it: the
sentences that have figures, or a date, are kept with the run (`beside`). When a run is measured anew its tables and
what is computed from them are renewed; sentences that were bound are not any more, until somebody looked them over
(`scripts/bench.py bind RUN`).

A marker without a number stands before text alone; `<!-- results: none -->` before what nobody here measured.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from results import Kept

MARKED = "docs/benchmarks.md"  # the page on which every table is of a run
WHOLE = ("README.md", "docs/index.md", MARKED)  # of the others, what follows a marker, and what is quoted
NOBODYS = "none"  # stands for a run where nobody here measured
MARKER = re.compile(r"<!-- results: (?P<run>[\w-]+)(?: (?P<number>\d+))?(?P<columns>(?: \| [^|\n]+)*) -->\n")
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
UNITS = r"%|mm|µm|m?s|°|degrees?|[GMk]B|nats?|times|points|pixels"
FIGURE = re.compile(rf"\d(?: ?(?:{UNITS})(?!\w)| of \d|\.\d|-\d\d-\d\d)")
HOLE = r"([-+]?\d{1,3}(?: \d{3})+(?!\d)|[-+]?\d+(?:\.\d+)?)"
SENTENCE = re.compile(r"(?<=[.:;])\**\s+(?=[^a-z\d])")


class Results(dict[str, Kept]):
    """The runs by name, and their numbers. What is not there raises LookupError."""

    def at(self, run: str, number: int, column: str | int, *words: str) -> list[float]:
        """The numbers of a cell: of the first row that begins with `words`."""
        return self[run].table(number).numbers(column, *words)

    def column(self, run: str, number: int, *columns: str | int) -> list[float]:
        """The first numbers of columns' cells."""
        return [value for column in columns for value in self[run].table(number).column(column)]


@dataclass(frozen=True)
class Quote:
    """A part of a page's text whose figures are those of results: `{}` stands for each, `values` computes them.

    A figure agrees if it is its value, rounded to as many decimals as are written. Without `values` what the text says
    was not measured: a setting, a definition, somebody else's.
    """

    page: str
    text: str
    values: Callable[[Results], Sequence[float]] = lambda results: ()

    @property
    def pattern(self) -> re.Pattern[str]:
        """What finds the text, however its lines are broken."""
        parts = (r"\s+".join(re.escape(word) for word in re.split(r"\s+", part)) for part in self.text.split("{}"))
        return re.compile(HOLE.join(parts))

    def found(self, text: str) -> re.Match[str]:
        """Return where a page has it. Raises LookupError unless it is there once."""
        matches = list(self.pattern.finditer(text))
        if len(matches) != 1:
            raise LookupError(f"the page should say so once, and does {len(matches)} times")
        return matches[0]

    def renewed(self, text: str, results: Results) -> str:
        """Return the page's text with the values written where it has others."""
        match, values = self.found(text), self.values(results)
        if len(values) != len(match.groups()):
            raise LookupError(f"{len(values)} values are given")
        for group in range(len(values), 0, -1):
            start, end = match.span(group)
            text = text[:start] + written(values[group - 1], match[group]) + text[end:]
        return text


def written(value: float, before: str) -> str:
    """Return a value as it is written where `before` stands: that itself if it agrees, else with as many decimals."""
    decimals = len(before.partition(".")[2])
    if abs(value - float(before.replace(" ", ""))) <= 0.5 * 10**-decimals * (1 + 1e-9):
        return before
    sign = "+" if before.startswith("+") and value > 0 else ""
    text = f"{sign}{value:,.{decimals}f}"
    return text.replace(",", " " if abs(value) >= 10_000 else "")


@dataclass(frozen=True)
class Sentence:
    """A sentence with figures that no quote has, the section it is in, and the run that it tells of, if any."""

    page: str
    section: str
    run: str
    text: str


def with_tables(text: str, results: Results) -> str:
    """Return a page's text with every marked table as it is kept. Raises LookupError for one that is not."""
    parts, end = [], 0
    for marker in MARKER.finditer(text):
        if marker["number"] is None:
            continue
        if marker["run"] not in results:
            raise LookupError(f"there is no run {marker['run']}; there are {', '.join(results)}")
        columns = [column.strip() for column in marker["columns"].split(" | ")[1:]]
        table = results[marker["run"]].table(int(marker["number"])).markdown(columns)
        shown = TABLE.match(text, marker.end() + 1) if text[marker.end() :].startswith("\n") else None
        parts += [text[end : marker.end()], "\n", table]
        end = shown.end() if shown else marker.end() + 1
    return "".join([*parts, text[end:]])


def unmarked(text: str) -> list[str]:
    """Return the first lines of a page's tables that follow no marker."""
    after = {marker.end() + 1 for marker in MARKER.finditer(text)}
    return [table[0].partition("\n")[0] for table in TABLE.finditer(_code_blanked(text)) if table.start() not in after]


def sentences(page: str, text: str, quotes: Sequence[Quote]) -> Iterator[Sentence]:
    """Find the sentences of a page that have figures which no quote has."""
    for section in re.split(r"^(?=#+ )", _code_blanked(_masked(text, quotes)), flags=re.MULTILINE):
        title = section.partition("\n")[0].lstrip("# ")
        run = next((marker["run"] for marker in MARKER.finditer(section) if marker["number"]), "")
        for block in re.split(r"\n\s*\n|\n(?=\s*(?:- |\d\. |<!--|\|))", section):
            if marker := MARKER.match(block + "\n"):
                run = marker["run"]
            elif not block.startswith(("#", "|", "<!--")):
                words = " ".join(re.sub(r"\]\([^)]*\)", "]", block).split())
                yield from (
                    Sentence(page, title, run, part)
                    for part in SENTENCE.split(words)
                    if FIGURE.search(re.sub(r"`[^`]*`", "", part))
                )


def _masked(text: str, quotes: Sequence[Quote]) -> str:
    """A page's text with {} for the numbers of what is quoted; quotes that are not there are passed over."""
    for quote in quotes:
        text = quote.pattern.sub(lambda match: re.sub(HOLE, "{}", match[0]), text)
    return text


def _code_blanked(text: str) -> str:
    """A page's text with spaces for blocks of code."""
    return re.sub(r"^```.*?^```$", lambda match: re.sub(r"[^\n]", " ", match[0]), text, flags=re.MULTILINE | re.DOTALL)


def renewed(page: str, text: str, results: Results, quotes: Sequence[Quote]) -> tuple[str, list[str]]:
    """Return a page's text with its tables and quotes as kept, and what could not be done."""
    failed = []
    try:
        text = with_tables(text, results)
    except LookupError as error:
        failed.append(f"{page}: {error}")
    for quote in quotes:
        try:
            text = quote.renewed(text, results)
        except (LookupError, ValueError, ArithmeticError) as error:
            failed.append(f"{page}: quote {quote.text!r} of scripts/quotes.py: {error}")
    return text, failed


def checked(page: str, text: str, results: Results, quotes: Sequence[Quote]) -> list[str]:
    """Return what is not true of a page, or comes from nowhere, each with what to do."""
    new, problems = renewed(page, text, results, quotes)
    for old, now in zip(text.splitlines(), new.splitlines(), strict=False):
        if old != now:
            problems.append(f"{page} says otherwise than the results; run scripts/bench.py page:\n  {old}\n  {now}")
            break
    if page == MARKED:
        problems += [
            f"{page}: a table follows no marker of the results it comes from: {line}" for line in unmarked(text)
        ]
    for run, told in groupby(sentences(page, text, quotes), key=lambda one: one.run):
        known = results[run].beside if run in results else ()
        new_ones = [f"\n  {one.section}: {one.text}" for one in told if one.text not in known]
        if new_ones and run in results:
            problems.append(
                f"{page} tells of {run} what is not of its results; see if it is true, then run scripts/bench.py bind "
                f"{run}:{''.join(new_ones)}"
            )
        elif new_ones and run != NOBODYS and page in WHOLE:
            problems.append(f"{page} has figures of no results; quote them in scripts/quotes.py:{''.join(new_ones)}")
    return problems
