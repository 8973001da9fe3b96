#!/usr/bin/env python3
"""Report phrases that are hard to read, in pages, docstrings, comments and messages. `make lint` runs it.

It knows few patterns, the worst ones, and accepts no exception. Each has the advice that is printed with it.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "CHANGELOG.md", "SECURITY.md", "docs", "plugins_contrib", "examples")
CODE = ("tactile_loc", "cli", "plugins_contrib", "examples", "benchmarks", "scripts")
LONGEST = 40  # words of a sentence

# Anywhere in a sentence
PHRASES = {
    r"\b(?:is|are|was|were|be|been) (?:told|said)\b": "write 'is reported', or who reports it",
    r"\b(?:that|who|which) is none\b": "name what is wrong",
    r"\bbut for\b": "write 'except' or 'without'",
    r"\bone another\b": "write 'each other'",
    r"\bfor itself\b": "write 'separately' or 'on its own'",
    r"\bis that so\b": "write 'if so'",
    r"\bsays? so\b": "name what it says",
    r"\bthe like\b": "name the things, or write 'such as'",
    r"\bnobody\b": "write 'no one', or who does not",
    r"\bwhat (?:is|was|are|were) (?:told|said|refused|found|located|drawn|pressed|seen)\b": "use a noun",
}
# At the start of a sentence
STARTS = {
    r"(?:What|Whatever|Whoever) [^?]*\b(?:is|are|was|were|has|have|can|does)\b[^?]*[.:;]$": "start with a noun, not with a clause",
    r"(?:Is|Are|Was|Were|Does|Has|Have|Should) [^?]*, [^?]*[^?]$": "start with 'If'",
}

Prose = Iterator[tuple[int, str]]


def read_page(text: str) -> Prose:
    """Yield the first line and text of each paragraph, list item and table cell of a page."""
    fenced, block, first = False, [], 0
    for number, line in enumerate([*text.split("\n"), ""], 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        plain = not fenced and line.strip() and not line.startswith(("    ", "<", "```", "|", "#"))
        if block and (not plain or re.match(r"\s*(?:[-*]|\d+\.) ", line)):
            yield first, " ".join(block)
            block = []
        if plain:
            first = first if block else number
            block.append(line.strip())
        elif not fenced and line.startswith(("|", "#")):
            yield from ((number, cell) for cell in line.strip("#| ").split("|"))


def read_code(text: str) -> Prose:
    """Yield the line and text of each comment, and of each string that has a space."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield from ((node.lineno, part) for part in re.split(r"\n\s*\n", node.value))
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT and not token.string.startswith(("#!", "# type:", "# noqa", "# fmt:")):
            yield token.start[0], token.string.lstrip("# ")


def split_sentences(paragraph: str) -> list[str]:
    """Return the sentences of a paragraph, code and link targets left out."""
    paragraph = re.sub(r"`[^`]*`", "CODE", paragraph.replace("\n", " "))
    paragraph = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", paragraph)
    return [part.strip() for part in re.split(r"(?<=[.!?:;])\s+(?=[A-Z(])", paragraph)]


def find_faults(sentence: str) -> Iterator[str]:
    """Yield what is hard to read in a sentence, and the advice."""
    for pattern, advice in PHRASES.items():
        if found := re.search(pattern, sentence, re.IGNORECASE):
            yield f"'{found[0]}': {advice}"
    for pattern, advice in STARTS.items():
        if re.match(pattern, sentence):
            yield f"'{' '.join(sentence.split()[:4])} ...': {advice}"
    if (count := len(sentence.split())) > LONGEST:
        yield f"'{' '.join(sentence.split()[:4])} ...': {count} words; split it"


def list_files(names: tuple[str, ...], suffix: str) -> list[Path]:
    """Return the files of a suffix below files and folders, without generated ones."""
    paths = [ROOT / name for name in names]
    return sorted(f for p in paths for f in ([p] if p.is_file() else p.rglob(f"*{suffix}")) if f.suffix == suffix)


def main() -> int:
    """Print each fault, and return 1 if there is one."""
    count = 0
    for suffix, names, read in ((".md", PAGES, read_page), (".py", CODE, read_code)):
        for path in list_files(names, suffix):
            for line, paragraph in read(path.read_text(encoding="utf-8")):
                for sentence in split_sentences(paragraph):
                    for fault in find_faults(sentence):
                        print(f"{path.relative_to(ROOT)}:{line}: {fault}", file=sys.stderr)
                        count += 1
    return min(count, 1)


if __name__ == "__main__":
    sys.exit(main())
