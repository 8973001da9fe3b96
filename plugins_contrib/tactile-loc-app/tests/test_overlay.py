"""The card over the view: the verdict's colour and sentence, the remaining time, and texts shown literally."""

import time
from types import SimpleNamespace

import pytest
from tactile_loc import Localizer, Palette, localize_together

from tactile_loc_app.index_page import Visit, brand_page
from tactile_loc_app.page.overlay import Overlay, describe_verdict, write_seconds


@pytest.fixture
def overlay() -> Overlay:
    html = SimpleNamespace(content="")
    return Overlay(SimpleNamespace(gui=SimpleNamespace(add_html=lambda content: html)))


@pytest.fixture(scope="module")
def results(store):
    localizer = Localizer.create("pin", sensor="gelsight-mini", store=store)
    touches = [(localizer, touch) for touch in localizer.simulate_together(3, seed=3)]
    return [localize_together(touches[:count]) for count in (1, 3)]


def test_the_card_states_the_verdict_in_its_colour_with_one_sentence(overlay, results):
    for found in results:
        overlay.show_result(found)
        text = overlay._handle.content
        assert str(found.verdict) in text
        assert Palette.find_verdict(found.verdict) in text
        sentence = describe_verdict(found)
        assert sentence.startswith(f"{len(found.touches)} touch")
        assert sentence.endswith(".")
        assert "\n" not in sentence
    overlay.clear()
    assert overlay._handle.content == ""


def test_the_remaining_time_follows_from_the_share(overlay, monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    overlay.begin("working")
    assert " left" not in overlay._handle.content
    now_s[0] += 10.0
    overlay.show_progress("working", 0.25)
    assert "about 30 s left" in overlay._handle.content
    assert [write_seconds(seconds) for seconds in (0.2, 45, 120)] == ["1 s", "45 s", "2 min"]


def test_a_text_is_shown_literally(overlay):
    overlay.show_hint("<b>part</b>")
    assert "<b>" not in overlay._handle.content


def test_a_visit_has_a_number_and_the_page_a_title():
    name = "0123456789abcdef" * 2
    assert Visit.read(f"/?token=x&visit={name}") == Visit(name)
    assert Visit.read(f"/?visit={name}&again=1") == Visit(name, is_again=True)
    assert {Visit.read(path) for path in ("/", "/?visit=", f"/?visit={name}0", "/?visit=../x")} == {Visit()}
    page = b'<link rel="icon" href="data:image/svg+xml,old"/><title>Viser</title>'
    branded = brand_page(page, False).decode()
    assert "<title>tactile-loc</title>" in branded
    assert "old" not in branded
