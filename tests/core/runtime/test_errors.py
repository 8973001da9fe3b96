"""An error is one printable line of limited length."""

import pytest

from tactile_loc.core.runtime import errors
from tactile_loc.core.runtime.errors import ConfigError, TactileLocError, did_you_mean, fold_line, name_source, quote


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("two\nlines", "two lines"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("a\x00b", "a\\x00b"),
        ("\ud800", "\\ud800"),
        ("é \u202e", "é \\u202e"),
    ],
)
def test_unprintable_characters_are_escaped(text, shown):
    assert str(TactileLocError(text)) == fold_line(text) == shown


def test_a_very_long_message_keeps_its_beginning_and_end():
    said = str(ConfigError(f"key = {'x' * 10**6} is wrong; give a number"))
    assert len(said) < 1600
    assert said.startswith("key = xxx")
    assert said.endswith("xxx is wrong; give a number")


def test_long_values_are_shortened():
    assert quote([1.5, "a"]) == "[1.5, 'a']"
    assert len(quote(list(range(10**5)))) < 100
    assert len(quote("x" * 10**5)) < 300


def test_errors_name_their_source_once():
    with pytest.raises(ConfigError, match=r"^plan\.toml: wrong$"), name_source("plan.toml"):
        raise ConfigError("wrong")
    with pytest.raises(ConfigError, match=r"^wrong in plan\.toml$"), name_source("plan.toml"):
        raise ConfigError("wrong in plan.toml")
    with pytest.raises(ConfigError, match=r"^wrong in \\xe4 1$"), name_source("\udce4\n1"):
        raise ConfigError("wrong in \udce4\n1")


@pytest.mark.parametrize(
    ("name", "known", "meant"),
    [
        ("pni", ["pin", "hook"], ["pin"]),
        ("gausian", ["gaussian", "region"], ["gaussian"]),
        ("T_sensor_flange", ["T_flange_sensor", "xyz_mm"], ["T_flange_sensor"]),
        ("spacing", ["spacing_mm", "tilt_deg"], ["spacing_mm"]),
        ("contact", ["mount", "run"], []),
        ("loud", ["none", "mild", "strong"], []),
        ("foo", ["face", "hopf", "whole", "pin", "hook"], []),
        ("", ["a", "bc"], []),
    ],
)
def test_only_similar_names_are_suggested(name, known, meant):
    said = did_you_mean(name, known)
    assert [other for other in known if repr(other) in said] == meant
    assert bool(said) == bool(meant)


def test_every_error_derives_from_the_project_error():
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert len(kinds) > 10
    assert all(issubclass(kind, TactileLocError) for kind in kinds)
