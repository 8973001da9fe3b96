import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.config import RunConfig, parse_overrides, parse_settings
from tactile_loc.io.options import TUNABLE
from tactile_loc.slots.registry import SLOTS


def test_an_empty_table_gives_a_complete_configuration():
    config = RunConfig.from_dict({})
    assert config.object.path
    assert all(getattr(config, slot).name for slot in SLOTS)
    assert RunConfig() == config


@pytest.mark.parametrize(
    "written", [{"name": "icp", "max_iterations": 7}, {"name": "icp", "options": {"max_iterations": 7}}, "icp"]
)
def test_a_slot_may_be_flat_or_nested_or_a_name_alone(written):
    slot = RunConfig.from_dict({"refiner": written}).refiner
    assert (slot.name, slot.options) == ("icp", {} if written == "icp" else {"max_iterations": 7})


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"refinr": "icp"}, "'refinr'.*'refiner'"),
        ({"top": 0}, "top cannot be 0"),
        ({"top": "ten"}, "top cannot be 'ten'"),
        ({"seed": -1}, "seed cannot be -1"),
        ({"shape_px": 8}, "shape_px cannot be 8"),
        ({"temperature": 0}, "temperature cannot be 0"),
        ({"object": {"units": "furlong"}}, "object.units cannot be 'furlong'"),
        ({"object": {"file": "x.stl"}}, "object.file"),
        ({"object": "pin"}, "object cannot be 'pin'"),
        ({"touch": {"unit": "cm"}}, "touch.unit"),
        ({"refiner": 3}, "refiner cannot be 3"),
        ({"refiner": None}, "refiner cannot be None"),
        ({"refiner": {"max_iterations": 7}}, "refiner.name"),
        ({"refiner": {"name": "icp", "options": {}, "reach": 1}}, "refiner.reach"),
        ({"search": {"registred": 5}}, naming("search.registred", "registered")),
        ({"search": {"registered": 0}}, naming("search.registered", 0, 1)),
    ],
)
def test_a_bad_value_is_refused_with_its_source_and_entry(values, named):
    with pytest.raises(ConfigError, match=named) as refused:
        RunConfig.from_dict(values, "run.toml")
    assert "run.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    contents = {
        "bad.toml": (b"top = = 3", ["TOML", "line 1"]),
        "binary.toml": (b"\xfftop", ["0xff"]),
        "typo.toml": (b"tpo = 3", ["'tpo'", "'top'"]),
        "none.toml": (None, [tmp_path / "none.toml"]),
        "": (None, [tmp_path]),
    }
    for name, (content, words) in contents.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=naming(name, *words)):
            RunConfig.from_toml(tmp_path / name)


def test_overrides_are_read_as_toml_or_as_text():
    words = [
        "grid.face=+z",
        "grid.spacing_mm=3.5",
        "refiner.max_iterations = 7",
        "refiner.walls=false",
        "sensor.image_size_px=[80, 60]",
        'sensor.path="a=b.toml"',
        "encoder.signal=depth",
    ]
    assert parse_overrides(words) == {
        "grid": {"face": "+z", "spacing_mm": 3.5},
        "refiner": {"max_iterations": 7, "walls": False},
        "sensor": {"image_size_px": [80, 60], "path": "a=b.toml"},
        "encoder": {"signal": "depth"},
    }
    assert parse_overrides([]) == {}
    assert parse_overrides(["grid.spacing_mm=3", "grid.spacing_mm=4"]) == {"grid": {"spacing_mm": 4}}


def test_overrides_of_another_form_or_an_unknown_slot_are_refused():
    for word in ("grid", "grid.face", "grid=face", "=3", "grid.=3", ".face=3", "grid. =3"):
        with pytest.raises(ConfigError):
            parse_overrides([word])
    with pytest.raises(ConfigError, match=naming("'refinr'", "'refinr.walls=true'", "'refiner'")):
        parse_overrides(["refinr.walls=true"])


def test_plain_settings_are_separated_from_options_of_components():
    words = ["seed=4", "grid.spacing_mm=3", "shape_px = 96", "grid=face", "seed"]
    assert parse_settings(words) == ({"seed": 4, "shape_px": 96}, ["grid.spacing_mm=3", "grid=face", "seed"])


def test_tuning_numbers_are_tables_of_the_configuration():
    words = ["search.registered=50", "tracker.modes=3", "hypotheses.refined=5", "grid.directions=400"]
    tables = parse_overrides(words, (*SLOTS, *TUNABLE))
    assert tables["grid"] == {"directions": 400}
    config = RunConfig.from_dict({name: tables[name] for name in TUNABLE})
    assert (config.search.registered, config.tracker.modes, config.hypotheses.refined) == (50, 3, 5)
    with pytest.raises(ConfigError, match=naming("'search'")):
        parse_overrides(["search.registered=50"])
