"""Shell completion, through the requests that the shells make."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from cli_helpers import HANGS_S, command
from tactile_loc_cli.main import app
from test_startup import HEAVY, PROBE
from typer.testing import CliRunner

from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.slots.registry import registry

WITH_CHOSEN_SHELL = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}


def ask(line: list[str], **environment: str) -> str:
    done = subprocess.run(line, env={**os.environ, **environment}, capture_output=True, text=True, timeout=HANGS_S)
    assert done.stderr == ""
    return done.stdout


def bash(words: str) -> set[str]:
    """Return the completions in bash of the last word of a line; the word may be empty."""
    typed = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split(" ")) - 1)}
    asked = {**typed, "_TACTILE_LOC_COMPLETE": "complete_bash"}
    done = CliRunner().invoke(app, [], env=asked, prog_name="tactile-loc")
    assert done.stderr == ""
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("words", "completions"),
    [
        *((f"run --{slot} ", registry().names(slot)) for slot in ("sensor", "renderer", "refiner")),
        ("run --renderer r", {"raycast"}),
        ("evaluate --encoder pixel --encoder mo", {"moco"}),
        ("run --sensor ./", ()),  # the shell offers files
        ("evaluate --object ", DEMO_OBJECTS),
        ("plugins ", registry().kinds),
        ("plugins grid ", registry().names("grid")),
        ("plugins nonsense ", ()),
        ("ev", {"evaluate"}),
        ("store ", {"list", "size", "prune"}),
        ("run --noise ", {"none", "mild", "strong"}),
    ],
)
def test_names_commands_and_choices_are_completed(words, completions):
    assert bash(f"tactile-loc {words}") == set(completions)


def test_options_and_commands_as_components_are_completed():
    assert "--json" in bash("tactile-loc objects --")
    assert "run" in bash("tactile-loc plugins command ")


def test_zsh_and_fish_get_descriptions_of_names():
    typed = {"_TYPER_COMPLETE_ARGS": "tactile-loc run --object "}
    zsh = ask(command(), **typed, _TACTILE_LOC_COMPLETE="complete_zsh")
    assert re.search(r'"pin":"\w', zsh)
    as_fish = {"_TACTILE_LOC_COMPLETE": "complete_fish", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    fish = ask(command(), **typed, **as_fish).splitlines()
    assert [line.split("\t")[0] for line in fish] == list(DEMO_OBJECTS)  # one line per name
    assert all(line.split("\t")[1] for line in fish)


@pytest.mark.parametrize("words", ["run --refiner ", "run --object ", "plugins grid ", "pl"])
def test_completion_imports_no_heavy_library(words):
    typed = {"COMP_WORDS": f"tactile-loc {words}", "COMP_CWORD": str(len(words.split(" ")))}
    environment = {**os.environ, **typed, "_TACTILE_LOC_COMPLETE": "complete_bash"}
    line = [sys.executable, "-c", PROBE]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=HANGS_S)
    code, modules = json.loads(done.stderr)
    assert (code, bool(done.stdout)) == (0, True)
    assert HEAVY & set(modules) == set()


@pytest.mark.parametrize(
    ("shell", "path"),
    [
        ("bash", ".bash_completions/tactile-loc.sh"),
        pytest.param("zsh", ".zfunc/_tactile-loc", marks=pytest.mark.slow),
        pytest.param("fish", ".config/fish/completions/tactile-loc.fish", marks=pytest.mark.slow),
    ],
)
def test_completion_is_installed_for_each_shell(tmp_path, shell, path):
    environment = {"HOME": str(tmp_path), **WITH_CHOSEN_SHELL}
    assert path in ask(command("--install-completion", shell), **environment).replace("\n", "")
    shown = ask(command("--show-completion", shell), **environment)
    assert (tmp_path / path).read_text().strip() == shown.strip()
    assert f"_TACTILE_LOC_COMPLETE=complete_{shell}" in shown


@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")
def test_the_bash_script_completes_a_line(tmp_path: Path):
    program = tmp_path / "tactile-loc"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tactile_loc_cli.main "$@"\n')
    program.chmod(0o755)
    script = ask(command("--show-completion", "bash"), **WITH_CHOSEN_SHELL)
    line = "COMP_WORDS=(tactile-loc run --grid h); COMP_CWORD=3; _tactile_loc_completion tactile-loc"
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    assert ask(["bash", "-c", f'{script}\n{line}\necho "${{COMPREPLY[@]}}"'], PATH=path) == "hopf\n"
