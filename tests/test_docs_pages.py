"""What single pages state is true: commands, tables, messages, limits and files. Their examples work."""

import ast
import json
import re
import shlex
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from functools import cache
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import quality_pictures
import tables
from page_helpers import DOCS, ROOT, find_blocks, list_commands, read_page, understand, write_part
from PIL import Image
from results import read_latest
from tactile_loc_cli.main import app
from typer.main import get_command
from typer.testing import CliRunner

from tactile_loc import Localizer, RunConfig, read_approaches, reports, write_touch
from tactile_loc.io.options import TUNABLE
from tactile_loc.io.prior_files import read_prior
from tactile_loc.io.touch_lists import read_labelled_touches, read_touch_list
from tactile_loc.locate.result.result_arrays import MOST_FACES, MOST_POSES, pack_arrays
from tactile_loc.locate.result.verdict import MEANINGS, Verdict
from tactile_loc.plugin.helpers import is_rigid
from tactile_loc.plugins.sensors.presets import Preset
from tactile_loc.slots.registry import BUILT_IN, SLOTS, registry
from tactile_loc.view.palette import DARK, LIGHT

PAGES = ["README.md", *(path.relative_to(DOCS).as_posix() for path in sorted(DOCS.rglob("*.md")))]
README, REPORTS, TROUBLE = map(read_page, ("README.md", "reports.md", "troubleshooting.md"))
FACE = {"grid": {"name": "face", "spacing_mm": 8.0}}


NAV = re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2])
LOOKED_UP = {"other-tools.md", "cli.md", "conventions.md", "files.md", "platforms.md"}  # their tables come first
FIRST_SCREEN = 30  # lines of a page that are visible before a reader scrolls
SHOWN = re.compile(r" *(```|!\[|<img|<picture)")


def ours(page: str) -> list[list[str]]:
    """The `tactile-loc` commands of a page, in shell blocks and indented, without the program."""
    text = read_page(page)
    words = [*list_commands(text), *map(shlex.split, re.findall(r"^    (tactile-loc [^<#\n]*)", text, re.MULTILINE))]
    return [line[1:] for line in words if line[0] == "tactile-loc"]


@pytest.mark.parametrize("page", [page for page in PAGES if page != "cli.md" and ours(page)])
def test_every_command_of_a_page_is_valid(page):
    for words in ours(page):
        understand(words)  # raises on an option that does not exist


@pytest.mark.parametrize("page", [page for page in NAV if page not in LOOKED_UP and not page.startswith("api/")])
def test_a_page_shows_a_picture_or_a_command_within_the_first_screen(page):
    assert any(map(SHOWN.match, read_page(page).splitlines()[:FIRST_SCREEN]))


def test_the_pages_that_are_looked_up_exist():
    assert set(NAV) >= LOOKED_UP


@pytest.fixture
def workplace(tmp_path, monkeypatch, store) -> Path:
    """A folder with a part, a folder of parts, and the shared store."""
    write_part(tmp_path / "part.stl")
    (tmp_path / "parts").mkdir()
    for name in ("pin", "cotter"):
        write_part(tmp_path / "parts" / f"{name}.stl", name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    return tmp_path


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, **FACE)


# README


def test_the_python_example_of_the_readme_runs(monkeypatch, store, capsys):
    original = Localizer.create.__func__
    monkeypatch.setattr(Localizer, "create", classmethod(lambda cls, *a, **k: original(cls, *a, **k, store=store)))
    (example,) = find_blocks(README, "python")
    exec(compile(example, "README.md", "exec"), {})
    verdict, *lines = capsys.readouterr().out.splitlines()
    assert verdict == Verdict.CERTAIN, "the moving picture shows these touches"
    assert lines
    assert all(re.fullmatch(r" *[\d.]+%  at -?[\d.]+, -?[\d.]+, -?[\d.]+ mm", line) for line in lines)


def test_the_readme_is_short_and_begins_with_a_small_moving_picture():
    assert len(README.split()) <= 600
    shown = re.findall(r'"(docs/images/[^"]+)"', README.split("```")[0])
    assert len(shown) == 2, "for dark and for light pages"
    for path in shown:
        assert (ROOT / path).stat().st_size <= 3_000_000
        with Image.open(ROOT / path) as picture:
            assert picture.n_frames > 20


def test_every_make_target_of_the_readme_exists():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    shown = {words[1] for words in list_commands(README) if words[0] == "make"}
    assert shown | set(re.findall(r"`make ([a-z]+)`", README)) <= set(targets)


# benchmarks.md


@pytest.mark.parametrize("name", quality_pictures.PICTURES)
@pytest.mark.parametrize("palette", [LIGHT, DARK])
def test_a_picture_shows_the_kept_results(name, palette):
    read, draw = quality_pictures.PICTURES[name]
    values = read(read_latest())
    picture = quality_pictures.find_picture(name, palette)
    assert quality_pictures.read_values(picture) == values, "run python docs/quality_pictures.py"
    assert f"({picture.relative_to(DOCS).as_posix()}#only-" in read_page("benchmarks.md")
    assert draw(values).axes


# plugins.md


@pytest.mark.parametrize("slot", SLOTS)
def test_the_page_lists_the_components_of_a_slot(slot):
    section = read_page("plugins.md").partition("\n## Built-in components\n")[2].partition("\n## ")[0]
    (row,) = re.findall(rf"^\| {slot} \| (.*) \|$", section, re.MULTILINE)
    own = {c.spec.name for c in registry().components if c.spec.slot == slot and c.distribution == BUILT_IN}
    assert set(re.findall(r"`([\w-]+)`", row)) == own


# reports.md


def test_the_table_lists_the_arrays_of_the_file(localizer):
    localization = localizer.localize(localizer.simulate(1)[0])
    written = {"schema_version", "result_sha256", *pack_arrays(localization.posterior, localization.touches)}
    rows = re.findall(r"^\| (`[^|]*) \| ([^|]*) \|", REPORTS, re.MULTILINE)
    named = {name: meaning for names, meaning in rows for name in re.findall(r"`(\w+)`", names)}
    assert written == {name for name, meaning in named.items() if "optional" not in meaning}
    assert set(named) - written == {"touch_0_observed", "touch_0_image", "log_train", "left_out_0_depth_m"}


def test_the_limits_and_the_functions_of_reports_exist():
    text = REPORTS.replace("\n", " ")
    assert f"{MOST_POSES:,} poses".replace(",", " ") in text
    assert f"{MOST_FACES:,} triangles".replace(",", " ") in text
    assert "`write_report(Path(" in text
    assert callable(reports.write_report)


# tuning.md


def test_every_tunable_option_is_listed_with_its_default_and_its_effect():
    page = read_page("tuning.md")
    assert [marker[1] for marker in tables.MARKER.finditer(page)] == list(TUNABLE)
    assert tables.with_tables(page) == page, "run python docs/tables.py"
    effects = tables.read_effects(page)
    assert set(effects) == tables.options()
    assert all(effects.values())
    assert set(re.findall(rf"`((?:{'|'.join(TUNABLE)})\.\w+)`", page)) == tables.options()


def test_the_settings_of_the_page_on_tuning_work(tmp_path, monkeypatch, store):
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    names: dict[str, Any] = {}
    exec(find_blocks(read_page("tuning.md"), "python")[0], names)
    (tmp_path / "run.toml").write_text(find_blocks(read_page("tuning.md"), "toml")[0])
    for config in (names["localizer"].config, RunConfig.from_toml(tmp_path / "run.toml")):
        assert (config.search.registered, config.hypotheses.refined) == (500, 30)


# troubleshooting.md


@cache
def list_texts() -> tuple[str, ...]:
    """All strings of the code, with … for the values in formatted strings."""
    folders = ("tactile_loc", "cli", "plugins_contrib")
    trees = [ast.parse(path.read_text()) for folder in folders for path in (ROOT / folder).rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    formatted = [
        "".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values)
        for node in nodes
        if isinstance(node, ast.JoinedStr)
    ]
    return (*formatted, *(n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)))


def is_in_code(quote: str) -> bool:
    parts = [part.strip() for part in quote.split("…") if part.strip()]
    pattern = re.compile(".*".join(map(re.escape, parts)), re.DOTALL)
    return any(pattern.search(text) for text in list_texts())


def test_every_quoted_message_exists():
    quoted = [quote for quote in (" ".join(q.split()) for q in re.findall(r'"([^"|]+)"', TROUBLE)) if quote != "…"]
    assert len(quoted) > 15
    assert [quote for quote in quoted if not is_in_code(quote)] == []
    assert not is_in_code("the gel is … made of cheese")
    assert is_in_code("several poses explain the touch; …")


def test_every_uncertain_verdict_is_explained():
    rows = re.findall(r'^\| `([\w ]+)` \| "([^"]+)" \|', TROUBLE, re.MULTILINE)
    assert dict(rows) == {v.value: MEANINGS[v] for v in Verdict if v is not Verdict.CERTAIN}
    named = set(re.findall(r"`tactile-loc ([a-z-]+)", TROUBLE))
    assert named <= set(get_command(app).commands)


# files.md


def find_file(first: str) -> str:
    """The TOML or CSV block of files.md that begins with `first`."""
    (found,) = [b for b in find_blocks(read_page("files.md"), "(?:toml|csv)") if b.startswith(first)]
    return found


def list_sensors() -> list[dict[str, str]]:
    """The rows of the table of built-in sensors, by its headings."""
    table = read_page("files.md").split("\n## Sensors\n\n")[1].split("\n\n")[0].splitlines()
    heading, _, *rows = ([cell.strip(" `") for cell in line.strip("|").split("|")] for line in table)
    return [dict(zip(heading, row, strict=True)) for row in rows]


def test_the_table_of_sensors_lists_all_presets():
    names = registry().names("sensor")
    presets = [name for name in names if registry().load("sensor", name).__module__ == Preset.__module__]
    assert sorted(row["name"] for row in list_sensors()) == sorted(presets)


@pytest.mark.parametrize("row", list_sensors(), ids=lambda row: row["name"])
def test_the_table_of_sensors_states_the_numbers_of_the_code(row):
    geometry = registry().create("sensor", row["name"]).geometry
    x0, x1, y0, y1 = geometry.rectangle
    size_px, field_mm, mm_per_px, standoff_mm, depth_mm = (
        [float(number) for number in re.findall(r"[\d.]+", row[key].split("(")[0])]
        for key in ("image (w x h)", "field, mm", "mm per pixel", "standoff, mm", "maximal depth, mm")
    )
    assert row["camera"] == geometry.camera
    assert size_px == [geometry.width_px, geometry.height_px]
    assert field_mm == pytest.approx([1e3 * (x1 - x0), 1e3 * (y1 - y0)], abs=0.05)
    assert mm_per_px == pytest.approx([1e3 / scale for scale in geometry.scale_at_surface], abs=5e-5)
    assert (standoff_mm, depth_mm) == ([1e3 * geometry.standoff_m], [1e3 * geometry.max_depth_m])


def test_the_list_of_touches_can_be_read(localizer, tmp_path):
    write_touch(tmp_path / "first.npz", localizer.simulate(1)[0])
    (tmp_path / "second.png").touch()
    (tmp_path / "my_sensor").mkdir()
    (tmp_path / "my_sensor" / "calibration.json").write_text("{}")
    (tmp_path / "touches.toml").write_text(find_file("[[touch]]"))
    first, second = read_touch_list(tmp_path / "touches.toml")
    assert (first.path.name, first.sensor) == ("first.npz", "gelslim")
    assert Path(str(second.sensor)).name == "my_sensor"
    assert is_rigid(np.stack([np.asarray(t.T_base_sensor) for t in (first, second)]))
    assert np.asarray(first.T_base_sensor)[:3, 3] == pytest.approx([0.4, 0.0, 0.12])


def test_the_table_of_known_poses_can_be_read(tmp_path):
    for name in ("first", "second", "third"):
        (tmp_path / f"{name}.npz").touch()
    (tmp_path / "poses.csv").write_text(find_file("touch,"))
    examples = read_labelled_touches(tmp_path / "poses.csv")
    assert [len(example) for example in examples] == [2, 1]
    assert is_rigid(np.stack([touch.T_sensor_object for example in examples for touch in example]))
    assert examples[0][0].T_sensor_object[:3, 3] == pytest.approx([-0.012, 0.0035, 0.0246])


def test_the_prior_can_be_read(localizer, tmp_path):
    (tmp_path / "prior.toml").write_text(find_file('kind = "gaussian"'))
    prior = read_prior(tmp_path / "prior.toml", localizer.object)
    assert prior.frame == "base"
    weights = prior.view_from(np.eye(4))(localizer.model.grid.T_sensor_object)
    assert np.isfinite(weights).all()


# programs.md


@pytest.fixture
def service(workplace: Path) -> Iterator[tuple[str, Localizer]]:
    """The address of the page's server, and its localizer."""
    made: dict[str, Any] = {"__name__": "service"}
    exec(compile(find_blocks(read_page("programs.md"), "python")[0], "programs.md", "exec"), made)
    made["Service"].log_message = lambda *_: None
    server = ThreadingHTTPServer(("127.0.0.1", 0), made["Service"])
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", made["localizer"]
    server.shutdown()
    server.server_close()


def test_the_server_locates_touches_and_explains_errors(service, workplace):
    address, localizer = service
    write_touch(workplace / "touch.npz", touch := localizer.simulate(seed=3)[0])
    with urllib.request.urlopen(address, (workplace / "touch.npz").read_bytes(), timeout=600) as response:
        answer = json.load(response)
    best = localizer.localize(touch).best
    np.testing.assert_allclose(answer["hypotheses"][0]["pose"], best.T_sensor_object, atol=1e-6)
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(address, b"no touch", timeout=600)
    assert refused.value.code == 400
    assert json.load(refused.value)["error"]


@pytest.mark.slow
def test_the_processes_find_the_poses(workplace):
    processes = find_blocks(read_page("programs.md"), "python")[1]
    (workplace / "program.py").write_text(processes + "    print(len(poses), *poses[7].ravel())\n")
    done = subprocess.run([sys.executable, "program.py"], capture_output=True, text=True, timeout=600, check=True)
    count, *pose = map(float, done.stdout.split())
    localizer = Localizer.create("part.stl", units="mm")
    expected = localizer.localize(localizer.simulate(20)[7]).best.T_sensor_object
    assert count == 20
    np.testing.assert_array_equal(np.reshape(pose, (4, 4)), expected)


# chain.md


def list_rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading of chain.md."""
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## )", read_page("chain.md"), re.DOTALL | re.MULTILINE)
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in row] for row in rows]


def test_the_options_that_save_time_exist():
    rows = list_rows("Keep it quick")
    assert len(rows) >= 4
    for option, _ in rows:
        name, *words = shlex.split(option.strip("`"))
        get_command(app).commands[name].make_context(name, words, resilient_parsing=True)  # arguments are left out


@pytest.mark.slow
def test_the_chain_of_commands_runs_in_order_and_writes_the_listed_files(workplace):
    page = read_page("chain.md")
    assert set(re.findall(r"^```(\w+)\n", page, re.MULTILINE)) == {"toml", "sh"}
    (workplace / "part.toml").write_text(find_blocks(page, "toml")[0])
    before = {str(path.relative_to(workplace)) for path in workplace.rglob("*")}
    for program, *words in list_commands(page):
        done = CliRunner().invoke(app, words, prog_name=program)
        assert (program, done.exit_code) == ("tactile-loc", 0), (words, done.stderr)
    writers = {file: writer for files, writer, _ in list_rows("Files") for file in re.findall(r"`([^`]+)`", files)}
    assert {file for file in writers if not (workplace / file).is_file()} == set()
    assert {file for file in writers if file in before} == {file for file in writers if writers[file] == "you"}
    assert len(read_touch_list("touches/touches.toml")) == 3
    assert len(read_approaches("next/approaches.toml", np.eye(4))) == 50


@pytest.mark.slow
def test_the_touch_of_the_page_ranks_the_poses_of_its_list(workplace):
    page = read_page("vision.md")
    exec(compile(find_blocks(page, "python")[0], "vision.md", "exec"), {})
    (workplace / "prior.toml").write_text(find_blocks(page, "toml")[0])
    ((_, *words),) = list_commands(page)
    done = CliRunner().invoke(app, words, prog_name="tactile-loc")
    assert done.exit_code == 0, done.stderr
    shown, found = (
        re.findall(r"^ +(\d) +([\d.]+) +([\d.]+)$", text, re.MULTILINE)
        for text in (find_blocks(page, "text")[0], done.stdout)
    )
    assert sorted(row[:2] for row in found) == sorted(row[:2] for row in shown)
    np.testing.assert_allclose(
        [float(row[2]) for row in sorted(found)], [float(row[2]) for row in sorted(shown)], atol=5
    )
