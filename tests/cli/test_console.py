"""Progress bars show what the running task has to say, and nothing once it is over."""

from __future__ import annotations

from tactile_loc_cli.console import Bars


def test_a_note_is_shown_beside_its_bar(monkeypatch):
    import rich.progress

    shown = []
    update = rich.progress.Progress.update
    monkeypatch.setattr(
        rich.progress.Progress,
        "update",
        lambda self, *a, **k: (shown.append(k.get("description")), update(self, *a, **k)),
    )
    bars = Bars()
    bars.note("before any task")
    with bars.task("training", 3) as advance:
        advance(1)
        bars.note("loss 1.25")
    bars.note("after it")
    assert shown == ["training: loss 1.25"]
