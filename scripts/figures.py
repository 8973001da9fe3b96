"""The figures of the documentation: each comes from a results file, and is compared with it.

A table follows a marker that names a run, the number of its table and, if not all are shown, its columns:
`<!-- results: search 1 | object | build, s -->`. The figures of the text are either computed from tables (`quotes.py`)
or belong to a run. The run is that of the nearest marker above in the section, or of the section's first table. Its
results file keeps these sentences (`beside`). After a new measurement, tables and computed figures are renewed. The
other sentences must be looked over and bound again (`scripts/bench.py bind RUN`).

A marker without a number stands before text alone, `<!-- results: none -->` before what nobody here measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from quotes import QUOTES, SETTINGS, Values
from results import RESULTS, ROOT, Results, latest

MARKED = "docs/benchmarks/"  # the folder of pages on which every table is of a run
WHOLE = ("README.md", "docs/index.md", "docs/benchmarks")  # pages whose figures all have results
NOBODYS = "none"  # the run of what nobody here measured
MARKER = re.compile(r"<!-- results: (?P<run>[\w-]+)(?: (?P<number>\d+))?(?P<columns>(?: \| [^|\n]+)*) -->\n")
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
UNITS = r"%|mm|µm|m?s|°|degrees?|[GMk]B|nats?|times|points|pixels"
FIGURE = re.compile(rf"\d(?: ?(?:{UNITS})(?!\w)| of \d|\.\d|-\d\d-\d\d)")
HOLE = r"([-+]?\d{1,3}(?: \d{3})+(?!\d)|[-+]?\d+(?:\.\d+)?)"
SENTENCE = re.compile(r"(?<=[.:;])\**\s+(?=[^a-z\d])")


@dataclass(frozen=True)
class Quote:
    """A part of a page's text: `{}` stands for each figure, `values` computes them. Settings have no values.

    A figure agrees if it is its value, rounded to the decimals that are written.
    """

    text: str
    values: Values = lambda results: ()

    @property
    def pattern(self) -> re.Pattern[str]:
        """The pattern that finds the text, however its lines are broken."""
        parts = (r"\s+".join(re.escape(word) for word in re.split(r"\s+", part)) for part in self.text.split("{}"))
        return re.compile(HOLE.join(parts))

    def found(self, text: str) -> re.Match[str]:
        """Return where a page has the text. Raises LookupError unless it is there once."""
        matches = list(self.pattern.finditer(text))
        if len(matches) != 1:
            raise LookupError(f"the page should say so once, and does {len(matches)} times")
        return matches[0]

    def renewed(self, text: str, results: Results) -> str:
        """Return the page's text with the values in place of other figures."""
        match, values = self.found(text), self.values(results)
        if len(values) != len(match.groups()):
            raise LookupError(f"{len(values)} values are given")
        for group in range(len(values), 0, -1):
            start, end = match.span(group)
            text = text[:start] + written(values[group - 1], match[group]) + text[end:]
        return text


@dataclass(frozen=True)
class Sentence:
    """A sentence with figures that no quote has, its section, and the run that it belongs to, if any."""

    section: str
    run: str
    text: str


def quotes_of(page: str) -> list[Quote]:
    """Return the quotes of a page."""
    return [*map(Quote, SETTINGS.get(page, ())), *(Quote(*one) for one in QUOTES.get(page, {}).items())]


def written(value: float, before: str) -> str:
    """Return `before` if the value agrees with it, else the value with as many decimals."""
    decimals = len(before.partition(".")[2])
    if abs(value - float(before.replace(" ", ""))) <= 0.5 * 10**-decimals * (1 + 1e-9):
        return before
    sign = "+" if before.startswith("+") and value > 0 else ""
    return f"{sign}{value:,.{decimals}f}".replace(",", " " if abs(value) >= 10_000 else "")


def with_tables(text: str, results: Results) -> str:
    """Return a page's text with every marked table as it is kept. Raises LookupError for one that is not."""

    def renewed_table(shown: re.Match[str]) -> str:
        if shown["number"] is None:
            return shown[0]
        if shown["run"] not in results:
            raise LookupError(f"there is no run {shown['run']}; there are {', '.join(results)}")
        columns = [column.strip() for column in shown["columns"].split(" | ")[1:]]
        return shown["marker"] + "\n" + results[shown["run"]].table(int(shown["number"])).markdown(columns)

    return re.sub(rf"(?P<marker>{MARKER.pattern})(?:\n(?:^\|.*\n)*)?", renewed_table, text, flags=re.MULTILINE)


def unmarked(text: str) -> list[str]:
    """Return the first lines of a page's tables that follow no marker."""
    after = {marker.end() + 1 for marker in MARKER.finditer(text)}
    return [table[0].partition("\n")[0] for table in TABLE.finditer(_code_blanked(text)) if table.start() not in after]


def sentences(text: str, quotes: Sequence[Quote]) -> Iterator[Sentence]:
    """Find the sentences of a page that have figures which no quote has."""
    for quote in quotes:
        text = quote.pattern.sub(lambda match: re.sub(HOLE, "{}", match[0]), text)
    for section in re.split(r"^(?=#+ )", _code_blanked(text), flags=re.MULTILINE):
        title = section.partition("\n")[0].lstrip("# ")
        run = next((marker["run"] for marker in MARKER.finditer(section) if marker["number"]), "")
        for block in re.split(r"\n\s*\n|\n(?=\s*(?:- |\d\. |<!--|\|))", section):
            if marker := MARKER.match(block + "\n"):
                run = marker["run"]
            elif not block.startswith(("#", "|", "<!--")):
                words = " ".join(re.sub(r"\]\([^)]*\)", "]", block).split())
                for part in SENTENCE.split(words):
                    if FIGURE.search(re.sub(r"`[^`]*`", "", part)):
                        yield Sentence(title, run, part)


def _code_blanked(text: str) -> str:
    """Return a page's text with spaces for blocks of code."""
    return re.sub(r"^```.*?^```$", lambda match: re.sub(r"[^\n]", " ", match[0]), text, flags=re.MULTILINE | re.DOTALL)


def renewed(page: str, text: str, results: Results, quotes: Sequence[Quote]) -> tuple[str, list[str]]:
    """Return a page's text with its tables and quotes as kept, and the problems."""
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
    """Return what is not true of a page or comes from nowhere, each with what to do."""
    new, problems = renewed(page, text, results, quotes)
    for old, now in zip(text.splitlines(), new.splitlines(), strict=False):
        if old != now:
            problems.append(f"{page} differs from the results; run scripts/bench.py page:\n  {old}\n  {now}")
            break
    if page.startswith(MARKED):
        problems += [f"{page}: this table follows no marker of its results: {line}" for line in unmarked(text)]
    for run, told in groupby(sentences(text, quotes), key=lambda one: one.run):
        known = results[run].beside if run in results else ()
        new_ones = "".join(f"\n  {one.section}: {one.text}" for one in told if one.text not in known)
        if new_ones and run in results:
            problems.append(f"{page} tells of {run} what its results do not have; see if it is true, "
                            f"then run scripts/bench.py bind {run}:{new_ones}")  # fmt: skip
        elif new_ones and run != NOBODYS and page.startswith(WHOLE):
            problems.append(f"{page} has figures of no results; quote them in scripts/quotes.py:{new_ones}")
    return problems


def pages(root: Path = ROOT) -> dict[str, str]:
    """Return the texts of the pages that may have figures."""
    paths = [root / "README.md", *sorted((root / "docs").rglob("*.md"))]
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in paths if path.exists()}


def problems() -> list[str]:
    """Return what is not true of the documentation's figures."""
    results = latest()
    return [problem for page, text in pages().items() for problem in checked(page, text, results, quotes_of(page))]


def renew() -> list[Path]:
    """Write what comes from the results into the documentation. Return the changed pages."""
    results, changed = latest(), []
    for page, text in pages().items():
        new, _ = renewed(page, text, results, quotes_of(page))
        if new != text:
            (ROOT / page).write_text(new, encoding="utf-8")
            changed.append(ROOT / page)
    return changed


def bind(run: str, folder: Path = RESULTS, root: Path = ROOT) -> None:
    """Keep with a run the sentences that belong to it. Raises SystemExit for an unknown run."""
    results = latest(folder)
    if run not in results:
        raise SystemExit(f"bench: there is no run {run}; there are {', '.join(results)}")
    told = [one for page, text in pages(root).items() for one in sentences(text, quotes_of(page)) if one.run == run]
    replace(results[run], beside=[one.text for one in told]).write(folder)
