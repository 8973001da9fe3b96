"""Suites: reading, selecting, and one clear sentence for each mistake."""

from pathlib import Path

import pytest
from message_helpers import naming
from tactile_loc.core.runtime.errors import UnknownPluginError
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.plugin import ConfigError

from tactile_loc_benchmark.suite import Suite, list_suites, read_split

SMALL = """\
name = "small"
objects = ["pin", "own.stl"]
touches = [1, 3]
examples = 2
seed = 1
[[source]]
name = "sketch"
label = "pencil"
refused = 0.1
[[method]]
name = "guess"
"""


@pytest.fixture
def write(tmp_path):
    def write(text: str):
        path = tmp_path / "small.toml"
        path.write_text(text)
        return path

    return write


def test_an_entry_has_the_options_of_its_table(write):
    suite = Suite.from_toml(write(SMALL))
    (source,), (method,) = suite.source, suite.method
    assert (source.name, source.label, source.options) == ("sketch", "pencil", {"refused": 0.1})
    assert (method.name, method.label, method.options) == ("guess", "guess", {})


def test_objects_are_demo_objects_files_a_split_or_in_the_data_folder(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pin, own = Suite.from_toml(write(SMALL)).objects
    assert (pin.path, own.path) == ("pin", str(tmp_path / "own.stl"))
    named = SMALL.replace('["pin", "own.stl"]', '"quick"')
    assert len(Suite.from_toml(write(named)).objects) == len(read_split("quick"))
    assert all(Path(config.path).is_file() for config in Suite.from_toml(write(named)).objects)
    far = SMALL.replace("own.stl", "data:far/own.stl")
    assert Suite.from_toml(write(far), tmp_path).objects[1].path == str(tmp_path / "far" / "own.stl")
    with pytest.raises(ConfigError, match=naming("data:far/own.stl", "`data`")):
        Suite.from_toml(write(far))


def test_the_suites_that_come_with_the_package_can_be_read(tmp_path):
    assert "quick" in list_suites()
    for name in list_suites():
        suite = Suite.from_toml(name, tmp_path)
        assert suite.name == name


def test_the_splits_hold_objects():
    assert read_split("demo") == list(DEMO_OBJECTS)
    assert {*read_split("pins"), *read_split("bent")} < set(DEMO_OBJECTS)
    with pytest.raises(ConfigError, match=naming("'dem'", "'demo'")):
        read_split("dem")


@pytest.mark.parametrize(
    ("before", "after", "mentioned"),
    [
        ("touches = [1, 3]", "touches = [0]", ("touches", "0", "20")),
        ("touches = [1, 3]", "touches = [1, 21]", ("touches", "21", "20")),
        ("touches = [1, 3]", "touches = []", ("touches",)),
        ("touches = [1, 3]", "", ("touches", "missing")),
        ("examples = 2", "examples = 0", ("examples", "0")),
        ("seed = 1", "seed = -1", ("seed", "-1")),
        ("seed = 1", "seed = 1\npress = [0.5, 0.2]", ("press", "0.5")),
        ("seed = 1", "sed = 1", ("'sed'", "'seed'")),
        ('["pin", "own.stl"]', '"demos"', ("'demos'", "'demo'")),
        ('["pin", "own.stl"]', "3", ("objects", "3")),
        ('["pin", "own.stl"]', "[]", ("objects",)),
        ("refused = 0.1", "refusd = 0.1", ("'refusd'", "'refused'", "sketch")),
        ("refused = 0.1", "refused = 'many'", ("refused", "'many'", "sketch")),
        ('"guess"\n', '"guess"\n[[method]]\nname = "guess"\n', ("two", "'guess'", "label")),
        ('[[method]]\nname = "guess"\n', "", ("method",)),
        ('"guess"', '"gues"', ("'gues'", "'guess'")),
    ],
)
def test_each_mistake_is_named_with_its_file(write, before, after, mentioned):
    assert before in SMALL
    path = write(SMALL.replace(before, after))
    kind = UnknownPluginError if after == '"gues"' else ConfigError
    with pytest.raises(kind, match=naming(path, *mentioned)) as raised:
        Suite.from_toml(path)
    assert "\n" not in str(raised.value)


def test_a_missing_library_is_no_mistake(write):
    assert Suite.from_toml(write(SMALL.replace('"guess"', '"library-method"'))).method[0].name == "library-method"


@pytest.mark.parametrize(
    ("name", "mentioned"), [("quik", ("'quik'", "'quick'")), ("none.toml", ("none.toml",)), ("a/b", ("a/b",))]
)
def test_a_missing_suite_is_named(name, mentioned, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=naming(*mentioned)):
        Suite.from_toml(name)


def test_components_are_selected_by_label_and_added_by_name(write):
    suite = Suite.from_toml(write(SMALL))
    chosen = suite.select(["pencil"], ["oracle", "guess", "oracle"])
    assert [entry.options for entry in chosen.source] == [{"refused": 0.1}]
    assert [entry.label for entry in chosen.method] == ["oracle", "guess"]
    assert suite.select() == suite
    with pytest.raises(UnknownPluginError, match=naming("'pensil'", "pencil", "sketch")):
        suite.select(["pensil"])
