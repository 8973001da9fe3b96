"""The targets of mutation, their tests, and the mutants that count.

Mutants of annotations, texts, raised errors, log lines, code for type checkers, and operators on bits do not count. The
tests of a target are only the quick tests that mirror its files.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import Any

NOUNS, CURVED = "tests/test_nouns.py", "tests/core/sensing/test_curved_contact.py"
STORE = ("artifact", "files", "keys", "line_files", "store", "workspace")
SLOW = "imprint or first_use or dense or sizes"  # tests that are slow without a compiler
PROCESSES = "any_step or two_processes or killed_build"  # tests that start several processes
LOGGERS = {"log", "logger", "logging", "warnings"}
BITS = ("BitOr", "BitAnd", "BitXor", "LShift", "RShift")  # with floats these raise a TypeError, which any test notices

Mutation = Any  # cosmic-ray's MutationSpec: operator_name, occurrence, start_pos and end_pos
Place = tuple[int, int]  # line, from 1, and character of the line, from 0
Span = tuple[Place, Place]  # start of a part of a file, and the place just after its end


@dataclass(frozen=True)
class Target:
    """Files of tactile_loc that are mutated together, and the test files and options for pytest that judge them."""

    name: str
    files: tuple[str, ...]
    tests: tuple[str, ...]


def _mirror(name: str, *files: str, more: tuple[str, ...] = ()) -> Target:
    """Return a target of files, given without suffix, with the tests that mirror them. pytest also gets `more`."""
    tests = (f"tests/{folder}/test_{stem}.py" for folder, _, stem in (file.rpartition("/") for file in files))
    return Target(name, tuple(f"{file}.py" for file in files), (*tests, NOUNS, *more))


TARGETS = (
    _mirror("geometry", "core/geometry/rigid"),
    _mirror("contact", "core/sensing/contact", more=(CURVED, "-k", f"not ({SLOW})")),
    _mirror("poses", "core/poses/metric"),
    _mirror("posterior", "core/poses/posterior"),
    Target("fusing", ("bases/common_poses.py", "plugins/fusers/product.py", "plugins/fusers/kinematic.py"),
           ("tests/bases/test_common_poses.py", "tests/plugins/fusers", NOUNS)),
    _mirror("covariance", "core/objects/mesh", "core/geometry/hand_eye", "tracking/pose_filter"),
    _mirror("store", *(f"store/{name}" for name in STORE), more=("-k", f"not ({PROCESSES})")),
)  # fmt: skip


def counts(mutation: Mutation, spans: list[Span]) -> bool:
    """Return whether a mutant counts, given the parts of its file that `find_uncounted` returned."""
    kind, _, change = mutation.operator_name.rpartition("/")[2].partition("_")
    before, _, after = change.partition("_")
    mixes_bits = kind == "ReplaceBinaryOperator" and (before in BITS) != (after in BITS)
    return not mixes_bits and not any(start <= mutation.start_pos and mutation.end_pos <= end for start, end in spans)


def sample(mutations: list[tuple[str, Mutation]], count: int, seed: int) -> list[int]:
    """Return the indices of `count` randomly drawn mutants, given as (file, mutant). Their order has no influence."""
    names = [(file, mutation.operator_name, mutation.occurrence) for file, mutation in mutations]
    return Random(seed).sample(sorted(range(len(names)), key=names.__getitem__), min(count, len(names)))


def find_uncounted(source: str) -> list[Span]:
    """Return the parts of a file where mutants do not count."""
    lines = source.splitlines()
    return [_find_span(part, lines) for node in ast.walk(ast.parse(source)) for part in _find_uncounted(node)]


def _find_uncounted(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.FunctionDef):
        yield from (d for d in node.decorator_list if "njit" in ast.unparse(d))
        if node.returns is not None:
            yield node.returns
    elif isinstance(node, (ast.arg, ast.AnnAssign)) and node.annotation is not None:
        yield node.annotation
    elif isinstance(node, ast.ExceptHandler) and node.type is not None:
        yield from (part for part in ast.walk(node.type) if isinstance(part, ast.Attribute))  # not a name
    elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
        yield node.exc
    elif _is_text(node) or _is_log(node) or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
        yield node


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_log(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[0] in LOGGERS


def _find_span(node: ast.AST, lines: list[str]) -> Span:
    """Return the part of a file that a node covers; a decorator covers its whole line.

    Python counts bytes, and cosmic-ray counts characters.
    """
    if lines[node.lineno - 1].startswith("@"):
        return (node.lineno, 0), (node.end_lineno + 1, 0)
    start, end = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
    first, last = ((line, len(lines[line - 1].encode()[:column].decode())) for line, column in (start, end))
    return first, last
