"""Every capability is read by code outside the class that declares it."""

import ast
import dataclasses
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import tactile_loc
from tactile_loc.slots.component import Capabilities

DECLARED = {field.name for field in dataclasses.fields(Capabilities)}


def read_in(source: str) -> Iterator[str]:
    """Yield the capabilities X that are read as `capabilities.X`, or that are tags X or "not X" of contract checks."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "check":
            tags = (tag.value.removeprefix("not ") for tag in node.args[1:] if isinstance(tag, ast.Constant))
            yield from (tag for tag in tags if tag != "property")
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            owner = node.value
            name = owner.attr if isinstance(owner, ast.Attribute) else owner.id if isinstance(owner, ast.Name) else ""
            if name == "capabilities":
                yield node.attr


@cache
def read() -> frozenset[str]:
    """The capabilities that the code reads."""
    texts = (path.read_text() for path in Path(tactile_loc.__file__).parent.rglob("*.py"))
    names = {name for text in texts if "capabilities." in text or "@check(" in text for name in read_in(text)}
    return frozenset(names)


def test_code_reads_each_capability_and_only_declared_ones():
    assert sorted(read()) == sorted(DECLARED)


def test_each_capability_is_documented():
    text = Capabilities.__doc__ or ""
    assert [f.name for f in dataclasses.fields(Capabilities) if f"`{f.name}`" not in text] == []
