"""Modules imported ahead of their first use."""

import gc
import importlib
import sys

import pytest

from tactile_loc.core.runtime.lazy import import_ahead, pause_collection


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """A folder of modules that Python finds. They are forgotten after the test."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    return tmp_path


def test_modules_are_imported_in_order_by_another_thread(modules):
    for name in ("one_ahead", "two_ahead"):
        (modules / f"{name}.py").write_text("import sys, threading\nthread = threading.current_thread()\n")
    thread = import_ahead("one_ahead", "two_ahead")
    thread.join()
    assert [sys.modules[name].thread for name in ("one_ahead", "two_ahead")] == [thread, thread]


def test_a_failed_import_raises_its_error_where_the_module_is_used(modules):
    (modules / "broken_ahead.py").write_text("raise ImportError('a library is missing')\n")
    import_ahead("broken_ahead").join()
    with pytest.raises(ImportError, match="a library is missing"):
        importlib.import_module("broken_ahead")


@pytest.fixture
def collector():
    """The garbage collector, switched on now and without frozen objects. It is as before after the test."""
    looks, frozen = gc.isenabled(), gc.get_freeze_count()
    gc.enable()
    gc.unfreeze()
    yield gc
    if frozen:
        gc.freeze()
    (gc.enable if looks else gc.disable)()


def test_nothing_is_collected_in_a_block_and_its_objects_are_old_then(collector):
    collector.collect()
    with pause_collection():
        made = [[] for _ in range(10 * collector.get_threshold()[0])]
        assert not collector.isenabled()
    assert collector.isenabled()
    assert not any(one is made for one in collector.get_objects(generation=0))
    assert any(one is made for one in collector.get_objects(generation=2))


def test_a_collector_that_is_off_stays_off(collector):
    collector.disable()
    with pause_collection():
        pass
    assert not collector.isenabled()


def test_objects_that_the_program_has_frozen_stay_frozen(collector):
    collector.freeze()
    try:
        count = collector.get_freeze_count()
        with pause_collection():
            pass
        assert collector.get_freeze_count() >= count // 2 > 0
    finally:
        collector.unfreeze()
