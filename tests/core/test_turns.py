"""Work in turns: it stops at pauses, goes on in its next turn, and ends when nobody waits for it."""

import gc
import threading

import pytest

from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.turns import Turns, pause, takes_turns, without_pauses


def count_to(most: int, seen: list[int]) -> int:
    for number in range(most):
        seen.append(number)
        pause()
    return most


def test_work_stops_at_each_pause_and_returns_its_result():
    seen: list[int] = []
    turns = Turns(lambda: count_to(3, seen))
    assert seen == []
    for number in range(3):
        assert not turns.take()
        assert seen == list(range(number + 1))
    assert turns.take()
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
        return count_to(1, seen)

    assert not takes_turns()

    turns = Turns(work)
    assert not turns.take()
    assert len(seen) == 8
    assert turns.take()


def test_two_works_take_turns_independently():
    first, second = [], []
    one, other = Turns(lambda: count_to(2, first)), Turns(lambda: count_to(2, second))
    one.take()
    other.take()
    other.take()
    assert (first, second) == ([0], [0, 1])


def test_an_error_is_raised_where_the_turn_is_taken():
    def work() -> None:
        pause()
        raise TactileLocError("no pose fits")

    turns = Turns(work)
    assert not turns.take()
    with pytest.raises(TactileLocError):
        turns.take()


def test_work_that_nobody_waits_for_ends_and_cleans_up():
    ended = threading.Event()

    def work() -> None:
        try:
            pause()
        finally:
            ended.set()

    turns = Turns(work)
    turns.take()
    del turns
    gc.collect()
    assert ended.wait(10)
