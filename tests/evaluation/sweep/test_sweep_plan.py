"""A plan: the values of a sweep, and its error messages."""

from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ConfigError, UnknownPluginError
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.evaluation.sweep.plan import (
    Plan,
    find_varied_options,
    merge_options,
    name_choice,
    read_options,
    split_all,
    split_values,
)
from tactile_loc.io.config import SlotConfig


def names(plan: Plan, slot: str) -> list[str]:
    return [chosen.name for chosen in plan.slots[slot]]


def test_an_empty_plan_evaluates_the_defaults():
    plan = Plan.from_values({})
    assert [one.path for one in plan.objects] == list(DEMO_OBJECTS)
    assert list(plan.slots) == ["sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser"]
    chosen = [names(plan, slot) for slot in plan.slots]
    assert chosen == [["gelslim"], ["heightmap"], ["face"], ["pixel"], ["dense"], ["joint"], ["product"]]
    assert (plan.noises, plan.seeds, plan.count) == (("strong",), (0,), 150)


def test_values_may_be_single_or_lists_and_duplicates_and_default_values_are_removed():
    plan = Plan.from_values({"object": "pin", "refiner": ["none", "icp", "none"], "seed": [1, "1", 2], "noise": "mild"})
    assert names(plan, "refiner") == ["none", "icp"]
    assert (plan.seeds, plan.noises) == ((1, 2), ("mild",))
    assert len(Plan.from_values({"encoder": ["pixel", {"name": "pixel", "cells": 20}]}).slots["encoder"]) == 1


def test_an_option_applies_to_the_components_that_have_it():
    plan = Plan.from_values({"refiner": ["none", "icp", "render"], "option": ["refiner.moving_points=100,200"]})
    found = [(one.name, one.options.get("moving_points")) for one in plan.slots["refiner"]]
    has = "moving_points" in plan.slots["refiner"][-1].options
    assert found == [("none", None), ("icp", 100), ("icp", 200)] + ([] if has else [("render", None)])


def test_a_plan_file_has_a_table_of_options(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(
        'object = ["pin", { path = "part.stl", units = "mm" }]\nseed = [0, 1]\n'
        "option.grid.spacing_mm = [3, 4]\noption.encoder.cells = 12\n"
    )
    plan = Plan.from_toml(path)
    assert [one.options["spacing_mm"] for one in plan.slots["grid"]] == [3.0, 4.0]
    assert plan.slots["encoder"][0].options["cells"] == 12
    assert (plan.objects[0].path, plan.objects[1].units) == ("pin", "mm")
    assert plan.objects[1].path == str(Path("part.stl").absolute())  # workers may run in another folder


def test_a_sensor_may_be_a_file_or_a_folder(tmp_path, flat_sensor, monkeypatch):
    monkeypatch.chdir(flat_sensor.parent)
    plan = Plan.from_values({"sensor": ["gelslim", flat_sensor.name, "./mine"]})
    assert names(plan, "sensor") == ["gelslim", "file", "calibrated"]
    assert plan.slots["sensor"][1].options["path"] == str(flat_sensor)


def test_the_description_of_a_plan_gives_the_same_plan():
    plan = Plan.from_values({"object": ["pin"], "refiner": ["none", "icp"], "seed": 3, "shape_px": 32})
    said = plan.describe()
    again = {key: value for key, value in said.items() if key != "temperature"}
    again |= {slot: [{"name": one["name"], **one["options"]} for one in said[slot]] for slot in plan.slots}
    assert Plan.from_values(again) == plan


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"refinr": "icp"}, "'refinr'"),
        ({"refiner": "ipc"}, "'ipc'"),
        ({"refiner": 3}, "refiner = 3"),
        ({"refiner": {"max_iterations": 3}}, "name"),
        ({"refiner": {"name": "icp", "max_iteration": 3}}, "'max_iterations'"),
        ({"refiner": []}, "'refiner'"),
        ({"option": ["grid.spacing_mm=coarse"]}, "spacing_mm"),
        ({"option": ["grid.spacing=3"]}, "'spacing_mm'"),
        ({"option": ["gird.spacing_mm=3"]}, "'grid'"),
        ({"option": ["grid.spacing_mm"]}, "SLOT.OPTION=VALUE"),
        ({"option": ["grid.spacing_mm="]}, "spacing_mm"),
        ({"option": {"grid": 3}}, "option.grid"),
        ({"option": {"gird": {"spacing_mm": 3}}}, "gird"),
        ({"option": {"grid": {"spacing_mm": []}}}, "spacing_mm"),
        ({"noise": "loud"}, "'loud'"),
        ({"seed": -1}, "seed cannot be -1"),
        ({"seed": "x"}, "seed cannot be 'x'"),
        ({"seed": True}, "seed cannot be True"),
        ({"count": 0}, "count cannot be 0"),
        ({"count": [1, 2]}, "'count'"),
        ({"object": [{"units": "mm"}]}, "path"),
        ({"object": [{"path": "pin", "unit": "mm"}]}, "'units'"),
        ({"object": [7]}, "7"),
        ({"shape_px": 3}, "shape_px"),
    ],
)
def test_a_wrong_plan_gives_a_one_sentence_error(values, said):
    kind = UnknownPluginError if values == {"refiner": "ipc"} else ConfigError
    with pytest.raises(kind, match=naming(said)) as caught:
        Plan.from_values(values, "sweep.toml")
    assert "\n" not in str(caught.value)


def test_an_error_names_the_plan_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("cuont = 3")
    with pytest.raises(ConfigError, match=naming("mine.toml", "'cuont'", "'count'")):
        Plan.from_toml(path)
    path.write_text("= 3")
    with pytest.raises(ConfigError, match=naming("mine.toml", "TOML", "line 1")):
        Plan.from_toml(path)


def choice(name: str, **options: object) -> SlotConfig:
    return SlotConfig(name=name, options=options)


def test_an_option_varies_only_within_a_component():
    choices = [choice("icp", rounds=3, points=9), choice("icp", rounds=5, points=9), choice("render", rounds=7)]
    assert find_varied_options(choices) == ["rounds"]
    assert find_varied_options(choices[::2]) == []


def test_a_label_holds_the_varying_options():
    for chosen, varying, label in (
        (choice("icp", rounds=3, points=9), ["rounds"], "icp rounds=3"),
        (choice("face", spacing_mm=4.0, face="auto"), ["spacing_mm", "face"], "face spacing_mm=4 face=auto"),
        (choice("none"), ["rounds"], "none"),
        (choice("file", path="/far/away/mine.toml", flat=True), ["path", "flat"], "file path=mine.toml flat=true"),
    ):
        assert name_choice(chosen, varying) == label


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("none,icp", ["none", "icp"]),
        (" none , icp ,", ["none", "icp"]),
        ("one", ["one"]),
        ("[1,2],[3]", ["[1,2]", "[3]"]),
        ("'a,b',c", ["'a,b'", "c"]),
        ('{x="}",y=2},3', ['{x="}",y=2}', "3"]),
        ("", []),
    ],
)
def test_values_are_split_at_commas_outside_brackets_and_quotes(text, parts):
    assert split_values(text) == parts
    assert split_all([text, "render"]) == [*parts, "render"], "a flag may be repeated"


def test_repeated_options_add_their_values():
    words = ["grid.spacing_mm=3,4.5", "encoder.signal=depth", "grid.spacing_mm=6", "grid.face='auto'"]
    assert read_options(words, "here") == {
        "grid": {"spacing_mm": [3, 4.5, 6], "face": ["auto"]},
        "encoder": {"signal": ["depth"]},
    }


def test_options_of_the_command_line_replace_those_of_the_file():
    file = read_options({"grid": {"spacing_mm": [3, 4], "face": "auto"}}, "file")
    assert merge_options(file, read_options(["grid.spacing_mm=9"], "line")) == {
        "grid": {"spacing_mm": [9], "face": ["auto"]}
    }
