"""Work in turns: it stops at pauses, goes on in its next turn, and ends when nobody waits for it."""

import gc
import threading

import pytest

from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.runtime.turns import Turns, pause_before, split_into_turns, takes_turns, without_pauses


def count_to(most: int, seen: list[int]) -> int:
    for number in range(most):
        pause_before(1.0)
        seen.append(number)
    return most


def test_work_stops_at_each_pause_and_returns_its_result():
    seen: list[int] = []
    turns = Turns(lambda: count_to(3, seen))
    assert seen == []
    for number in range(3):
        assert turns.take() == (number == 2)
        assert seen == list(range(number + 1))
    assert turns.take()
    assert turns.result == 3


def test_pauses_do_nothing_outside_turns_and_where_they_are_switched_off():
    seen: list[int] = []
    assert count_to(2, seen) == 2

    def work() -> int:
        assert takes_turns()
        with without_pauses():
            assert not takes_turns()
            count_to(5, seen)
        return count_to(2, seen)

    assert not takes_turns()

    turns = Turns(work)
    assert not turns.take()
    assert len(seen) == 8
    assert turns.take()
    assert len(seen) == 9


def test_a_turn_ends_only_if_the_next_work_does_not_fit():
    seen: list[float] = []

    def work() -> None:
        for share in (0.5, 0.5, 0.25, 2.0, 0.25):
            pause_before(share)
            seen.append(share)

    turns = Turns(work)
    assert [(turns.take(), len(seen)) for _ in range(4)] == [(False, 2), (False, 3), (False, 4), (True, 5)]


def test_work_is_split_so_that_no_turn_has_too_many_items():
    seen: list[range] = []

    def work() -> None:
        for count in (10, 1, 0):
            seen.extend(range(count)[some] for some in split_into_turns(count, 4))

    turns, done = Turns(work), [0]
    while not turns.take():
        done.append(sum(map(len, seen)))
    assert done == [0, 4, 8]
    assert [number for some in seen for number in some] == [*range(10), 0]
    assert [range(10)[some] for some in split_into_turns(10, 4)] == [range(10)], "work that is not done in turns"


def test_two_works_take_turns_independently():
    first, second = [], []
    one, other = Turns(lambda: count_to(3, first)), Turns(lambda: count_to(3, second))
    one.take()
    other.take()
    other.take()
    assert (first, second) == ([0], [0, 1])


def test_an_error_is_raised_where_the_turn_is_taken():
    def work() -> None:
        count_to(2, [])
        raise TactileLocError("no pose fits")

    turns = Turns(work)
    assert not turns.take()
    with pytest.raises(TactileLocError):
        turns.take()


def test_work_that_nobody_waits_for_ends_and_cleans_up():
    ended = threading.Event()

    def work() -> None:
        try:
            count_to(2, [])
        finally:
            ended.set()

    turns = Turns(work)
    turns.take()
    del turns
    gc.collect()
    assert ended.wait(10)
