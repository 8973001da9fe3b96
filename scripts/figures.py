"""The figures of the documentation. Each figure comes from a results file, and is compared with this file.

A marker before each table names a run, the number of the run's table, and the columns unless all are shown:
`<!-- results: search 1 | object | build, s -->`. A figure in the text is either computed from tables (`quotes.py`), or
its sentence belongs to a run. This run is named by the nearest marker above in the section, or by the section's first
table. The run's results file keeps such sentences (`beside`). A new measurement renews tables and computed figures. A
person must check the other sentences, and bind them again (`scripts/bench.py bind RUN`).

A marker without a number stands before text alone. `<!-- results: none -->` stands before figures from other sources.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from pathlib import Path

from quotes import QUOTES, SETTINGS, Values
from results import RESULTS, ROOT, Results, read_latest

MARKED = "docs/benchmarks/"  # folder of pages where every table belongs to a run
WHOLE = ("README.md", "docs/index.md", "docs/benchmarks")  # pages where every figure has results
ELSEWHERE = "none"  # the run of figures from other sources
MARKER = re.compile(r"<!-- results: (?P<run>[\w-]+)(?: (?P<number>\d+))?(?P<columns>(?: \| [^|\n]+)*) -->\n")
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
UNITS = r"%|mm|µm|m?s|°|degrees?|[GMk]B|nats?|times|points|pixels"
FIGURE = re.compile(rf"\d(?: ?(?:{UNITS})(?!\w)| of \d|\.\d|-\d\d-\d\d)")
HOLE = r"([-+]?\d{1,3}(?: \d{3})+(?!\d)|[-+]?\d+(?:\.\d+)?)"
SENTENCE = re.compile(r"(?<=[.:;])\**\s+(?=[^a-z\d])")


@dataclass(frozen=True)
class Quote:
    """A part of a page's text with `{}` for each figure. `values` computes the figures, and is empty for settings.

    A figure is right if it is the value rounded to the decimals that the page shows.
    """

    text: str
    values: Values = lambda results: ()

    @property
    def pattern(self) -> re.Pattern[str]:
        """The pattern that finds the text with any line breaks."""
        parts = (r"\s+".join(re.escape(word) for word in re.split(r"\s+", part)) for part in self.text.split("{}"))
        return re.compile(HOLE.join(parts))

    def find(self, text: str) -> re.Match[str]:
        """Return the match of the text in a page. Raises LookupError unless the page has the text exactly once."""
        matches = list(self.pattern.finditer(text))
        if len(matches) != 1:
            raise LookupError(f"the page has this text {len(matches)} times, and should have it once")
        return matches[0]

    def renew(self, text: str, results: Results) -> str:
        """Return a page's text with the computed figures."""
        match, values = self.find(text), self.values(results)
        if len(values) != len(match.groups()):
            raise LookupError(f"{len(values)} values for {len(match.groups())} figures")
        for group in range(len(values), 0, -1):
            start, end = match.span(group)
            text = text[:start] + format_figure(values[group - 1], match[group]) + text[end:]
        return text


@dataclass(frozen=True)
class Sentence:
    """A sentence with figures that no quote computes, its section, and its run (empty if it has no run)."""

    section: str
    run: str
    text: str


def list_quotes(page: str) -> list[Quote]:
    """Return the quotes of a page."""
    return [*map(Quote, SETTINGS.get(page, ())), *(Quote(*one) for one in QUOTES.get(page, {}).items())]


def format_figure(value: float, before: str) -> str:
    """Return `before` if it is the rounded value. Otherwise, return the value with as many decimals."""
    decimals = len(before.partition(".")[2])
    if abs(value - float(before.replace(" ", ""))) <= 0.5 * 10**-decimals * (1 + 1e-9):
        return before
    sign = "+" if before.startswith("+") and value > 0 else ""
    return f"{sign}{value:,.{decimals}f}".replace(",", " " if abs(value) >= 10_000 else "")


def renew_tables(text: str, results: Results) -> str:
    """Return a page's text with the kept table after each marker. Raises LookupError for an unknown run or table."""

    def format_table(shown: re.Match[str]) -> str:
        if shown["number"] is None:
            return shown[0]
        if shown["run"] not in results:
            raise LookupError(f"there is no run {shown['run']}; there are {', '.join(results)}")
        columns = [column.strip() for column in shown["columns"].split(" | ")[1:]]
        table = results[shown["run"]].table(int(shown["number"])).markdown(columns)
        return f"{shown['marker']}\n{table}" + ("\n" if shown["rest"] == "\n" else "")

    return re.sub(rf"(?P<marker>{MARKER.pattern})(?P<rest>\n(?:^\|.*\n)*)?", format_table, text, flags=re.MULTILINE)


def find_unmarked(text: str) -> list[str]:
    """Return the first line of each table without a marker."""
    after = {marker.end() + 1 for marker in MARKER.finditer(text)}
    return [table[0].partition("\n")[0] for table in TABLE.finditer(_blank_code(text)) if table.start() not in after]


def find_sentences(text: str, quotes: Sequence[Quote]) -> Iterator[Sentence]:
    """Yield the sentences of a page that have figures outside of quotes."""
    for quote in quotes:
        text = quote.pattern.sub(lambda match: re.sub(HOLE, "{}", match[0]), text)
    for section in re.split(r"^(?=#+ )", _blank_code(text), flags=re.MULTILINE):
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


def _blank_code(text: str) -> str:
    """Return a page's text with spaces in place of blocks of code."""
    return re.sub(r"^```.*?^```$", lambda match: re.sub(r"[^\n]", " ", match[0]), text, flags=re.MULTILINE | re.DOTALL)


def renew_page(page: str, text: str, results: Results, quotes: Sequence[Quote]) -> tuple[str, list[str]]:
    """Return a page's text with the kept tables and the computed figures, and the problems."""
    failed = []
    try:
        text = renew_tables(text, results)
    except LookupError as error:
        failed.append(f"{page}: {error}")
    for quote in quotes:
        try:
            text = quote.renew(text, results)
        except (LookupError, ValueError, ArithmeticError) as error:
            failed.append(f"{page}: quote {quote.text!r} of scripts/quotes.py: {error}")
    return text, failed


def check_page(page: str, text: str, results: Results, quotes: Sequence[Quote]) -> list[str]:
    """Return the problems of a page: wrong figures, and figures without results."""
    new, problems = renew_page(page, text, results, quotes)
    for old, now in zip(text.splitlines(), new.splitlines(), strict=False):
        if old != now:
            problems.append(f"{page} differs from the results; run scripts/bench.py page:\n  {old}\n  {now}")
            break
    if page.startswith(MARKED):
        problems += [f"{page}: this table has no marker of its results: {line}" for line in find_unmarked(text)]
    for run, group in groupby(find_sentences(text, quotes), key=lambda one: one.run):
        known = results[run].beside if run in results else ()
        new_ones = "".join(f"\n  {one.section}: {one.text}" for one in group if one.text not in known)
        if new_ones and run in results:
            problems.append(f"{page} has figures of {run} that are not bound to its results; check them, "
                            f"then run scripts/bench.py bind {run}:{new_ones}")  # fmt: skip
        elif new_ones and run != ELSEWHERE and page.startswith(WHOLE):
            problems.append(f"{page} has figures without results; quote them in scripts/quotes.py:{new_ones}")
    return problems


def read_pages(root: Path = ROOT) -> dict[str, str]:
    """Return the texts of all pages. The keys are the pages' paths."""
    paths = [root / "README.md", *sorted((root / "docs").rglob("*.md")), *sorted((root / "notes").glob("*.md"))]
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in paths if path.exists()}


def find_problems() -> list[str]:
    """Return the problems of the documentation's figures."""
    results = read_latest()
    found = (check_page(page, text, results, list_quotes(page)) for page, text in read_pages().items())
    return list(chain.from_iterable(found))


def renew_pages() -> list[Path]:
    """Write the results into the documentation. Return the changed pages."""
    results, changed = read_latest(), []
    for page, text in read_pages().items():
        new, _ = renew_page(page, text, results, list_quotes(page))
        if new != text:
            (ROOT / page).write_text(new, encoding="utf-8")
            changed.append(ROOT / page)
    return changed


def bind(run: str, folder: Path = RESULTS, root: Path = ROOT) -> None:
    """Keep the documentation's sentences about a run in its results file. Raises SystemExit for an unknown run."""
    results = read_latest(folder)
    if run not in results:
        raise SystemExit(f"bench: there is no run {run}; there are {', '.join(results)}")
    found = (find_sentences(text, list_quotes(page)) for page, text in read_pages(root).items())
    bound = [one.text for one in chain.from_iterable(found) if one.run == run]
    replace(results[run], beside=bound).write(folder)
