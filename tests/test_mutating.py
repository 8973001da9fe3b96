"""Mutants without an observable effect do not count, and the sample depends only on the seed."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from mutants import TARGETS, counts, find_uncounted

ROOT = Path(__file__).parents[1]

SOURCE = '''
if TYPE_CHECKING:
    LIMIT = 111

@njit
def area(a: Literal[112], b: Literal[113] | None = 1) -> Literal[114]:
    """Of 115."""
    total: Literal[116] = a * 2
    log.info("µ %d", 117)
    if total > 3:
        raise ValueError(f"{total + 118} is too much")
    try:
        return total - 4, f"{119}"
    except (error.Other, ValueError):
        return 5, ""
'''


@dataclass
class Mutant:
    operator_name: str
    occurrence: int
    start_pos: tuple[int, int]
    end_pos: tuple[int, int]


def at(text: str, operator: str = "core/NumberReplacer") -> Mutant:
    """A mutant of a text that occurs in the source."""
    start = SOURCE.index(text)
    return Mutant(operator, 0, place(start), place(start + len(text)))


def place(offset: int) -> tuple[int, int]:
    before = SOURCE[:offset]
    return before.count("\n") + 1, len(before) - before.rfind("\n") - 1


@pytest.mark.parametrize("text", ["= 1)", "* 2", "> 3", "- 4", "ValueError)", "return 5"])
def test_mutants_of_behaviour_count(text):
    assert counts(at(text), find_uncounted(SOURCE))


@pytest.mark.parametrize("text", ["@njit\n", "error.Other", *map(str, range(111, 120))])
def test_mutants_without_observable_effect_do_not_count(text):
    assert not counts(at(text), find_uncounted(SOURCE))


@pytest.mark.parametrize(
    ("change", "expected"), [("Mul_Div", True), ("Mul_LShift", False), ("BitAnd_BitOr", True), ("BitOr_Add", False)]
)
def test_operators_change_only_within_arithmetic_or_within_bits(change, expected):
    assert counts(at("* 2", f"core/ReplaceBinaryOperator_{change}"), find_uncounted(SOURCE)) is expected


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_files_and_tests_of_a_target_exist(target):
    assert all((ROOT / "tactile_loc" / file).is_file() for file in target.files)
    assert all((ROOT / test).exists() for test in target.tests if test.startswith("tests/"))
