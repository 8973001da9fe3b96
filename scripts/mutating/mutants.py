"""Which mutants of a file count: not those of annotations, of texts, of what only a type checker reads, or of bits."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from random import Random
from typing import NamedTuple, Protocol

Place = tuple[int, int]  # line, from 1, and character of the line, from 0

LOGGERS = {"log", "logger", "logging", "warnings"}
BITS = ("BitOr", "BitAnd", "BitXor", "LShift", "RShift")  # of floats: a TypeError, which any test would notice


class Mutation(Protocol):
    """What cosmic-ray knows of a mutant."""

    operator_name: str
    occurrence: int
    start_pos: Place
    end_pos: Place


class Span(NamedTuple):
    """A part of a file, from `start` to before `end`."""

    start: Place
    end: Place


def counts(mutation: Mutation, spans: list[Span]) -> bool:
    """Tell whether a mutant counts, given the parts of its file that `uncounted` found."""
    return not _of_bits(mutation.operator_name) and not any(
        span.start <= mutation.start_pos and mutation.end_pos <= span.end for span in spans
    )


def sample(mutations: list[tuple[str, Mutation]], count: int, seed: int) -> list[int]:
    """Draw the places of `count` mutants, each with its file's name: the same ones again from the same sources."""
    order = sorted(range(len(mutations)), key=lambda i: _name(*mutations[i]))
    return Random(seed).sample(order, min(count, len(order)))


def uncounted(source: str) -> list[Span]:
    """Return the parts of a file whose mutants do not count.

    These are annotations, all texts, what is raised and what is logged, and the blocks and decorators that do nothing
    when tests run without a compiler.
    """
    lines = source.splitlines()
    nodes = [part for node in ast.walk(ast.parse(source)) for part in _uncounted_parts(node)]
    return [_span(node, lines) for node in nodes]


def _uncounted_parts(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.FunctionDef):
        yield from (d for d in node.decorator_list if "njit" in ast.unparse(d))
        if node.returns is not None:
            yield node.returns
    elif isinstance(node, (ast.arg, ast.AnnAssign)) and node.annotation is not None:
        yield node.annotation
    elif isinstance(node, ast.ExceptHandler) and node.type is not None:
        yield from (part for part in ast.walk(node.type) if isinstance(part, ast.Attribute))  # cosmic-ray wants names
    elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
        yield node.exc
    elif _is_text(node) or _is_log(node) or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
        yield node


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_log(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[0] in LOGGERS


def _span(node: ast.AST, lines: list[str]) -> Span:
    """Where a node is: Python counts a line's bytes, cosmic-ray its characters; a decorator is the whole line."""
    if lines[node.lineno - 1].startswith("@"):
        return Span((node.lineno, 0), (node.end_lineno + 1, 0))
    start, end = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
    return Span(*((line, len(lines[line - 1].encode()[:column].decode())) for line, column in (start, end)))


def _of_bits(operator: str) -> bool:
    """Whether an operator puts one of bits for one of numbers, or the other way round."""
    kind, _, change = operator.rpartition("/")[2].partition("_")
    before, _, after = change.partition("_")
    return kind == "ReplaceBinaryOperator" and (before in BITS) != (after in BITS)


def _name(file: str, mutation: Mutation) -> tuple[str, str, int]:
    return file, mutation.operator_name, mutation.occurrence
