"""`tactile-loc new-plugin`: the written package works, passes its tests and is found; bad names are errors."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from cli_helpers import TINY, Cli, assert_refused, command
from message_helpers import naming
from tactile_loc_cli.scaffold import package
from tactile_loc_cli.scaffold.command import new_plugin
from tactile_loc_cli.scaffold.package import LONGEST, Naming

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.slots.registry import COMMAND, SLOTS, registry

OUR_RULES = Path(__file__).parents[2] / "pyproject.toml"


def name_of(slot: str) -> str:
    return f"my-{slot}"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a new package for each slot, and the metadata of an editable installation."""
    folder = tmp_path_factory.mktemp("site")
    for slot in registry().kinds:
        naming = Naming(slot, name_of(slot))
        package.write(naming, folder / naming.distribution)
        install(folder, folder / naming.distribution)
    return folder


def install(site: Path, source: Path) -> None:
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    points = project["entry-points"]["tactile_loc"]
    (info / "entry_points.txt").write_text("[tactile_loc]\n" + "".join(f"{k} = {v}\n" for k, v in points.items()))
    (module,) = source.glob("tactile_loc_*")
    (site / module.name).symlink_to(module)


def run(site: Path, line: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    variables = {k: v for k, v in os.environ.items() if k != "TACTILE_LOC_PLUGINS"}
    variables["PYTHONPATH"] = os.pathsep.join(filter(None, [str(site), variables.get("PYTHONPATH")]))
    return subprocess.run(
        line, cwd=site, env=variables | environment, capture_output=True, text=True, check=False, timeout=600
    )


@pytest.mark.slow
def test_every_new_package_passes_all_contract_checks_and_its_own_tests(site):
    folders = [Naming(slot, name_of(slot)).distribution for slot in registry().kinds]
    quiet = ["-q", "-p", "no:cacheprovider", "-p", "no:dash", "--rootdir", str(site), "--durations=0", "-vv"]
    done = run(site, [sys.executable, "-m", "pytest", *quiet, *folders])
    assert done.returncode == 0, done.stdout
    for slot in registry().kinds:
        naming = Naming(slot, name_of(slot))
        passed = [
            line for line in done.stdout.splitlines() if f"test_my_{naming.module}.py::" in line and "PASSED" in line
        ]
        least = 8 if slot in SLOTS else 2  # the checks of all components
        checked = naming.name if slot == COMMAND else naming.class_name
        assert len([line for line in passed if f"[{checked}-check_" in line]) > least
        assert [line for line in passed if "test_contract" not in line], f"{slot} has no own test that passed"


def test_every_new_component_is_found(site):
    told = json.loads(run(site, command("plugins", "--json")).stdout)
    listed = told["components"] + told["commands"]
    ours = {c["slot"]: c for c in listed if c["distribution"] == Naming(c["slot"], name_of(c["slot"])).distribution}
    assert ours.keys() == set(registry().kinds)
    assert all(c["name"] == name_of(slot) and c["summary"] for slot, c in ours.items())


@pytest.mark.slow
def test_all_new_components_locate_an_object_together(site, tmp_path):
    chosen = [word for slot in SLOTS for word in (f"--{slot}", name_of(slot))]
    (tmp_path / "sure.toml").write_text("temperature = 0.1")  # no temperature is fitted
    words = ["--config", tmp_path / "sure.toml", "--out", tmp_path / "out", "--store", tmp_path / "store"]
    line = command("run", "--object", "pin", *TINY, *chosen, *words)
    done = run(site, line)
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert {slot: result["configuration"][slot]["name"] for slot in SLOTS} == {s: name_of(s) for s in SLOTS}
    assert result["errors"]["best_listed_m"] < 0.02


def test_ruff_accepts_packages_with_names_of_any_length(tmp_path):
    pytest.importorskip("ruff")
    folders = []
    for name in ("a", "x" * LONGEST, "-".join("abcdefghij1234")):
        for slot in registry().kinds:
            folders.append(tmp_path / name / slot)
            package.write(Naming(slot, name), folders[-1])
    check, layout, ours = ["check", "--no-cache"], ["format", "--check", "--no-cache"], ["--config", str(OUR_RULES)]
    calls = [(tmp_path, check), (tmp_path, layout), (tmp_path, [*layout, *ours])]
    calls += [(folder, [*check, *ours]) for folder in folders]  # these rules find own modules from the current folder
    for folder, words in calls:
        line = [sys.executable, "-m", "ruff", *words, "."]
        done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


def test_the_output_lists_the_files_and_the_next_commands(cli: Cli, tmp_path):
    done = cli("new-plugin", "refiner", "my-spline")
    assert done.exit_code == 0, done.output
    written, _, following = done.stdout.partition("\nnext:\n")
    assert written.splitlines()[0] == "written: tactile-loc-my-spline"
    files = sorted(str(p.relative_to(tmp_path / "tactile-loc-my-spline")) for p in tmp_path.rglob("*") if p.is_file())
    assert [line.strip() for line in written.splitlines()[1:]] == files
    assert following.split("\n") == [
        "  pip install -e ./tactile-loc-my-spline",
        "  tactile-loc plugins refiner my-spline --check",
        "  pytest ./tactile-loc-my-spline",
        "",
    ]


def test_the_package_is_written_to_the_given_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written = new_plugin("matcher", "soft", Path("deep down/here"))
    assert (written["slot"], written["name"], written["folder"]) == ("matcher", "soft", "deep down/here")
    assert written.keys() == {"slot", "name", "folder", "files"}
    assert all((tmp_path / "deep down" / "here" / file).is_file() for file in written["files"])
    assert [p.name for p in (tmp_path / "deep down").iterdir()] == ["here"]


@pytest.mark.parametrize(
    ("slot", "name", "mentioned"),
    [
        *(("refiner", name, [repr(name), "hyphens"]) for name in ("My-own", "my_own", "-my", "my-", "my--own")),
        *(("refiner", name, [repr(name), "hyphens"]) for name in ("3d", "größer", "a b", "", "../x")),
        ("refiner", "x" * (LONGEST + 1), [str(LONGEST)]),
        ("refiner", "icp", ["'icp'", "tactile-loc"]),
        ("refiner", "cli", ["tactile_loc_cli"]),
        ("refinr", "mine", ["'refinr'", "'refiner'"]),
    ],
)
def test_an_invalid_or_used_name_and_an_unknown_slot_are_refused(cli, tmp_path, slot, name, mentioned):
    assert_refused(cli("new-plugin", slot, "--", name), *mentioned)
    assert list(tmp_path.iterdir()) == []


def test_a_name_must_be_unique_only_within_its_slot(cli):
    assert cli("new-plugin", "encoder", "icp").exit_code == 0


def test_a_kind_of_a_missing_annex_is_named_with_the_command_that_installs_it(cli, monkeypatch):
    monkeypatch.setenv("TACTILE_LOC_PLUGINS", "")
    registry.cache_clear()
    assert_refused(cli("new-plugin", "method", "mine"), "pip install ./plugins_contrib/tactile-loc-benchmark")
    registry.cache_clear()


def test_existing_files_and_folders_are_not_changed(cli, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("folder", "file", "link", "."):
        assert_refused(cli("new-plugin", "grid", "mine", "--out", name), "--out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder", "link"]
    assert list((tmp_path / "folder").iterdir()) == []
    assert (tmp_path / "file").read_text() == "mine"
    assert_refused(cli("new-plugin", "grid", "mine", "--out", "file/below"), "file/below")


def test_a_failed_write_leaves_no_files(tmp_path, monkeypatch):
    monkeypatch.setattr(package, "render", lambda naming: {"a": "written", "a/b": "cannot be, since a is a file"})
    with pytest.raises(OutputError, match=naming(tmp_path / "mine", "--out")):
        package.write(Naming("grid", "mine"), tmp_path / "mine")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("slot", "name", "class_name"),
    [
        ("refiner", "my-refiner", "MyRefiner"),
        ("refiner", "spline", "SplineRefiner"),
        ("refiner", "refiner", "RefinerRefiner"),
        ("grid", "two-face-3d", "TwoFace3dGrid"),
        ("touch-source", "my-touch-source", "MyTouchSource"),
        ("touch-source", "my-source", "MyTouchSource"),
        ("command", "my-command", "measure_object"),
    ],
)
def test_the_class_or_function_of_the_template_has_a_name(slot, name, class_name):
    assert Naming(slot, name).class_name == class_name
