"""Modules imported ahead of their first use."""

import importlib
import sys

import pytest

from tactile_loc.core.runtime.lazy import import_ahead


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
