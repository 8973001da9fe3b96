"""Third-party components and commands: missing libraries, failures, and equal names."""

import json
import re
from pathlib import Path

import pytest
from cli_helpers import TINY, assert_one_error
from message_helpers import missing
from tactile_loc_cli import ANNEXES

HOOK = """
from tactile_loc.slots.registry import ComponentSpec, hookimpl

@hookimpl
def tactile_loc_components():
    return [ComponentSpec("refiner", {name!r}, "{module}_parts:Part", "made up", {requires!r}, interface=2)]
"""


@pytest.fixture
def install(tmp_path: Path):
    """Return a function that installs an invented distribution into a folder for PYTHONPATH."""
    site = tmp_path / "site"

    def add(distribution: str, hook: str, parts: str = "") -> str:
        module = distribution.replace("-", "_")
        info = site / f"{module}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[tactile_loc]\n{distribution} = {module}\n")
        (site / f"{module}.py").write_text(hook)
        (site / f"{module}_parts.py").write_text(parts)
        return str(site)

    return add


def hook(name: str, module: str, requires: str = "") -> str:
    return HOOK.format(name=name, module=module, requires=requires)


def test_a_missing_library_is_reported_with_its_install_command(install, run_process):
    site = install("far-away", hook("far", "far_away", "faraway-lib"), "import faraway")
    listed = " ".join(run_process("plugins", "refiner", PYTHONPATH=site).stdout.split())
    assert not missing(listed, "refiner far far-away", "'far' needs faraway-lib", "pip install faraway-lib")
    done = run_process("run", *TINY, "--refiner", "far", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "'far'", "faraway", "pip install faraway-lib")


def test_a_failing_plugin_matters_only_when_it_is_chosen(install, run_process):
    site = install("broken-one", "raise RuntimeError('out of order')")
    listed = run_process("plugins", PYTHONPATH=site)
    assert listed.returncode == 0
    assert "icp" in listed.stdout
    (line,) = [line for line in listed.stdout.splitlines() if "broken-one" in line]
    assert "RuntimeError: out of order" in line
    done = run_process("run", *TINY, "--refiner", "broken", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "'broken'", "out of order")


def test_a_name_conflict_names_both_distributions(install, run_process):
    install("first-twin", hook("twin", "first_twin"), "")
    site = install("second-twin", hook("twin", "second_twin"), "")
    done = run_process("run", *TINY, "--refiner", "twin", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "first-twin", "second-twin")
    listed = run_process("plugins", PYTHONPATH=site)
    assert not missing(listed.stdout, "refiner 'twin'", "first-twin", "second-twin")
    alone = run_process("plugins", "refiner", PYTHONPATH=site, TACTILE_LOC_PLUGINS="first-twin")
    assert "first-twin" in alone.stdout
    assert "second-twin" not in alone.stdout


COMMAND_HOOK = """
from tactile_loc.plugin import CommandSpec, hookimpl

@hookimpl
def register_commands():
    return [CommandSpec({name!r}, "Greet.", "{module}_parts:{target}", {requires!r})]
"""
GREET = """
from typing import Annotated
import typer
from tactile_loc.commands import Finding, declare, say
from tactile_loc.plugin import ConfigError

application = typer.Typer()

@application.command()
def greet(name: Annotated[str, declare("--name NAME", "Who is greeted.")] = "all", fail: bool = False):
    \"\"\"Greet.\"\"\"
    if fail:
        raise ConfigError("nobody is there")
    say(f"hello {name}")
    return {"greeted": name}
"""


def command_hook(name: str, module: str, target: str = "greet", requires: str = "") -> str:
    return COMMAND_HOOK.format(name=name, module=module, target=target, requires=requires)


def test_a_command_of_a_package_behaves_like_a_built_in_one(install, run_process):
    install("polite", command_hook("greet", "polite"), GREET)
    site = install("grouped", command_hook("social", "grouped", "application"), GREET)
    listed = run_process("--help", PYTHONPATH=site).stdout
    assert re.search(r"^Commands of polite:\n  greet  Greet.$", listed, re.MULTILINE)
    assert run_process("greet", "--name", "you", PYTHONPATH=site).stdout == "hello you\n"
    assert json.loads(run_process("social", "greet", "--json", PYTHONPATH=site).stdout) == {"greeted": "all"}
    failed = run_process("greet", "--fail", "--json", PYTHONPATH=site)
    assert_one_error(failed.stderr, failed.returncode, "nobody is there")
    assert json.loads(failed.stdout)["error"]["kind"] == "ConfigError"
    for words, said in (("greet --nam", "--name"), ("gret", "mean 'greet'"), ("social gret", "mean 'greet'")):
        wrong = run_process(*words.split(), PYTHONPATH=site)
        assert_one_error(wrong.stderr, wrong.returncode, said)


def test_a_broken_command_is_one_sentence_when_it_is_called(install, run_process):
    install("half-polite", command_hook("bow", "half_polite"), "1 / 0")
    install("needy", command_hook("curtsy", "needy", requires="velvet-gloves"), "import velvet")
    install("first-twin", command_hook("nod", "first_twin"), GREET)
    install("second-twin", command_hook("nod", "second_twin"), GREET)
    site = install("broken-one", "raise RuntimeError('out of order')")
    assert run_process("--help", PYTHONPATH=site).returncode == 0
    for command, named in {
        "bow": ("'bow'", "half-polite", "ZeroDivisionError"),
        "curtsy": ("'curtsy'", "pip install velvet-gloves"),
        "nod": ("'nod'", "first-twin", "second-twin"),
        "wave": ("'wave'", "broken-one", "out of order"),
    }.items():
        done = run_process(command, "--json", "x", PYTHONPATH=site)
        assert_one_error(done.stderr, done.returncode, *named)
        assert named[-1] in json.loads(done.stdout)["error"]["message"]
    assert "Traceback" in run_process("bow", "-vv", PYTHONPATH=site).stderr


def test_a_missing_annex_is_reported_with_the_command_that_installs_it(cli, monkeypatch):
    monkeypatch.setitem(ANNEXES, "sing", "tactile-loc-choir")
    done = cli("sing", "--loud", "--json")
    assert_one_error(done.stderr, done.exit_code, "'sing'", "pip install ./plugins_contrib/tactile-loc-choir")
    assert json.loads(done.stdout)["error"]["kind"] == "MissingLibraryError"


@pytest.mark.slow
def test_missing_egl_is_reported_with_another_renderer(run_process):
    done = run_process("run", *TINY, "--renderer", "pyrender", "--out", "out", PYOPENGL_PLATFORM="no-such-platform")
    assert_one_error(done.stderr, done.returncode, "pyrender", "--renderer heightmap")
