#!/usr/bin/env python3
"""Report phrases that are hard to read, in pages, docstrings, comments and messages. `make lint` runs it.

The script knows only the worst patterns, and allows no exception. It prints advice with each fault.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "CHANGELOG.md", "SECURITY.md", "CONTRIBUTING.md", "docs", "notes", "plugins_contrib", "examples")
CODE = ("tactile_loc", "cli", "plugins_contrib", "examples", "benchmarks", "scripts")
GENERATED = ("docs/cli.md",)  # made from texts in the code, which are checked instead
LONGEST = 40  # words of a sentence

PARTICIPLES = "told|said|refused|found|located|drawn|pressed|seen"
# Patterns anywhere in a sentence. A group is the phrase to print. A column of the results is named *nobody*.
PHRASES = {
    r"\b(?:is|are|was|were|be|been) (?:told|said)\b": "write 'is reported', or who reports it",
    r"\b(?:that|who|which) is (?-i:none)\b": "name what is wrong",
    r"^(?:(?!\bnot\b).)*\b(but\sfor)\b": "write 'except' or 'without'",
    r"\bone another\b": "write 'each other'",
    r"\bfor itself\b": "write 'separately' or 'on its own'",
    r"\bis that so\b": "write 'if so'",
    r"\bsays? so\b": "name the statement",
    r"\bthe like\b": "name the things, or write 'such as'",
    r"(?<!\*)\bnobody\b(?=\W)": "write 'no one', or who does not",
    rf"\b(?:as|by|for|from|in|of|on|than|to|with) what (?:is|was|are|were) (?:{PARTICIPLES})\b": "use a noun",
}
# Patterns at the start of a sentence
STARTS = {
    r"(?:What|Whoever|Whatever(?! [^,]*,)) [^?:]*\b(?:is|are|was|were|has|have|can|does)\b[^?:]*[.;]$":
        "start with a noun, not with a clause",
    r"(?:Is|Are|Was|Were|Does|Has|Should) (?:an?|the|its?|they|there|th[ei]se?|that|those|no|one|all|any|both|CODE) "
    r"[^?]*, [^?]*[^?]$": "start with 'If'",
}  # fmt: skip

Prose = Iterator[tuple[int, str]]


def read_page(text: str) -> Prose:
    """Yield the first line and text of each paragraph, heading, list item and table cell of a page."""
    fenced, block, first = False, [], 0
    for number, line in enumerate([*text.split("\n"), ""], 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        is_code = fenced or line.lstrip().startswith("```") or (line.startswith("    ") and not block)
        is_prose = line.strip() and not is_code and not line.startswith(("<", "|", "#"))
        if block and (not is_prose or re.match(r"\s*(?:[-*]|\d+\.) ", line)):
            yield first, " ".join(block)
            block = []
        if is_prose:
            first = first if block else number
            block.append(line.strip())
        elif not is_code and line.startswith(("|", "#")):
            yield from ((number, cell.strip()) for cell in line.strip("#| ").split("|"))


def read_code(text: str) -> Prose:
    """Yield the line and text of each comment, and of each paragraph of a string with a space.

    A string with a block of code is read as a page.
    """
    parts: set[ast.AST] = set()  # of formatted strings
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):
            parts.update(node.values)
            values = [part.value if isinstance(part, ast.Constant) else "CODE" for part in node.values]
            yield node.lineno, "".join(map(str, values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in parts and " " in node.value:
            if "```" in node.value:
                yield from ((node.lineno + line - 1, found) for line, found in read_page(node.value))
                continue
            for found in re.finditer(r"(?:[^\n]+\n?)+", node.value):
                is_long = node.end_lineno - node.lineno == node.value.count("\n")  # one literal of several lines
                yield node.lineno + node.value.count("\n", 0, found.start()) * is_long, found[0]
    yield from read_comments(text)


def read_comments(text: str) -> Prose:
    """Yield the first line and text of each comment. Comments in consecutive lines count as one comment."""
    block, first, last = [], 0, 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or token.string.startswith(("#!", "# type:", "# noqa", "# fmt:")):
            continue
        line, column = token.start
        if block and (line > last + 1 or token.line[:column].strip()):
            yield first, " ".join(block)
            block = []
        first, last = first if block else line, line
        block.append(token.string.lstrip("# "))
    if block:
        yield first, " ".join(block)


def split_sentences(paragraph: str) -> list[str]:
    """Return the sentences of a paragraph, with CODE for code and without link targets."""
    paragraph = re.sub(r"`[^`]*`", "CODE", " ".join(paragraph.split()))
    paragraph = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", paragraph)
    return re.split(r"(?<=[.!?:;])[*_]*\s+(?=\W*[A-Z])", paragraph)


def find_faults(sentence: str) -> Iterator[str]:
    """Yield each phrase of a sentence that is hard to read, with advice."""
    for pattern, advice in PHRASES.items():
        if found := re.search(pattern, sentence, re.IGNORECASE):
            yield f"'{found[found.lastindex or 0]}': {advice}"
    words = sentence.split()
    start = f"'{' '.join(words[:4])} ...'"
    for pattern, advice in STARTS.items():
        if re.match(pattern, sentence.lstrip("-*_0123456789.( ")):
            yield f"{start}: {advice}"
    longest = max(len(clause.split()) for clause in sentence.split("; "))
    if longest > LONGEST and not sentence.startswith("|"):
        yield f"{start}: {longest} words; split it"


def list_files(root: Path, names: tuple[str, ...], suffix: str) -> list[Path]:
    """Return the files with a suffix among the named files and folders, without generated files."""
    paths = [root / name for name in names]
    files = {f for p in paths for f in ([p] if p.is_file() else p.rglob(f"*{suffix}")) if f.suffix == suffix}
    return sorted(files - {root / name for name in GENERATED})


def main(root: Path = ROOT) -> int:
    """Print each fault below a folder, and return 1 if there is one."""
    count = 0
    for suffix, names, read in ((".md", PAGES, read_page), (".py", CODE, read_code)):
        for path in list_files(root, names, suffix):
            for line, paragraph in read(path.read_text(encoding="utf-8")):
                for fault in (fault for sentence in split_sentences(paragraph) for fault in find_faults(sentence)):
                    print(f"{path.relative_to(root)}:{line}: {fault}")
                    count += 1
    return min(count, 1)


if __name__ == "__main__":
    sys.exit(main())
