"""Every code block of the documentation runs or is read by its reader.

Shell commands run in a folder with the files that they name. The tests add only a coarser grid, fewer touches and
shorter training. The blocks of some pages have separate tests, which ELSEWHERE names.
"""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_helpers import DOCS, ROOT, list_commands, read_page, write_part
from press_sets import COLUMNS, ball_set, write_image
from tactile_loc_cli.main import app
from typer.testing import CliRunner

from tactile_loc import LiveLocator, Localizer, RosPose, StageStore, Verdict, load_object, read_approaches, write_touch
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.evaluation.slides import draw_random_slide, write_slide
from tactile_loc.io.mount_files import HandEyeRecord, write_mount
from tactile_loc.io.prior_files import read_prior
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.io.streams.frame_sources import ImageFolder
from tactile_loc.io.touch_lists import read_touch_list
from tactile_loc.plugin.helpers import make_transform, rotation_about
from tactile_loc.testing.problems import press_block

ELSEWHERE = {
    "cli.md": "test_reference.py",  # generated
    "files.md": "test_docs_pages.py",
    "vision.md": "test_docs_pages.py",
    "plugins.md": "test_docs_plugins.py",
    "plugin-examples.md": "test_docs_plugins.py",
    "tutorial-plugin.md": "test_docs_tutorial.py",
    "sweeps.md": "test_docs_sweeps.py",
    "reports.md": "test_docs_pages.py",
    "programs.md": "test_docs_pages.py",
    "tuning.md": "test_docs_pages.py",
    "chain.md": "test_docs_pages.py",
    "other-tools.md": "test_docs_conversions.py",
    "examples.md": "test_examples.py",
    "app.md": "test_app_command.py",
    "benchmark.md": "test_docs_benchmark.py",
    "inspect.md": "test_inspect_page.py",
    "test-object.md": "test_test_object_page.py",
    "touchability.md": "test_touchability_page.py",
}
PAGES = sorted(p.name for p in DOCS.glob("*.md") if p.name not in ELSEWHERE)
READERS = {  # by the first word of the file
    "camera": read_sensor_file,
    "kind": lambda path: read_prior(path, load_object("pin")),
    "[[approach]]": lambda path: read_approaches(path, np.eye(4)),
    "[[touch]]": lambda path: read_touch_list(path, of_flange="T_base_flange" in path.read_text()),
    "mount": read_touch_list,
}
SURE = ["-o", "temperature=0.05"]  # no temperature is fitted
COARSE = ["--grid", "face", "-o", "grid.spacing_mm=10"]
SEARCHED = {"grid": {"name": "whole", "directions": 300}, "temperature": 0.05}  # for pages on whole objects
TINY_TRAINING = [word for o in ("epochs=1", "queries=32", "batch=16", "backbone=small", "channels=4")
                 for word in ("-o", f"encoder.{o}")]  # fmt: skip
CHEAPER = {
    "run": [*COARSE, *SURE],
    "build": [*COARSE, *SURE],
    "simulate": [*COARSE, "--count", "2"],
    "evaluate": [*COARSE, *SURE, "--count", "2"],
    "paper": [*COARSE, *SURE, "--count", "2"],
    "calibrate": ["-o", "steps=20", "-o", "hidden=4"],
    "mount": ["-o", "temperature=0.001", "-o", "grid.directions=300"],
    "replay": [*COARSE, "-o", "temperature=0.001"],
    "identify": ["-o", "temperature=0.05", "-o", "grid.directions=300"],
    "library build": ["--directions", "100", "--workers", "1"],
    "live": [*COARSE, "-o", "temperature=0.001", "--port", "0"],
}
Block = tuple[str, str]


def blocks(page: str) -> list[Block]:
    """The language and the text of each fenced block of a page."""
    return re.findall(r"^```(\w*)\n(.*?)^```", read_page(page), re.DOTALL | re.MULTILINE)


def commands(page: str) -> list[list[str]]:
    return list_commands(read_page(page))


def test_every_block_has_a_tested_language():
    """A block without a language is a formula or a drawing."""
    languages = {(page, language) for page in PAGES for language, _ in blocks(page)}
    tested = {"sh", "python", "toml", "csv", ""} | {"bash", "py"}  # the last two: tests/examples/test_insertion_page.py
    assert [(page, language) for page, language in languages if language not in tested] == []


def test_pages_with_separate_tests_exist_and_are_tested():
    assert [page for page in ELSEWHERE if not (DOCS / page).exists()] == []
    texts = {
        test.name: test.read_text()
        for folder in ("tests", "plugins_contrib")
        for test in (ROOT / folder).rglob("test_*.py")
    }
    assert [page for page, test in ELSEWHERE.items() if page not in texts[test]] == []


def test_the_table_of_presses_can_be_read():
    ((_, text),) = [block for block in blocks("sensor-labels.md") if block[0] == "csv"]
    rows = list(csv.DictReader(text.splitlines()))
    assert set(rows[0]) <= set(COLUMNS)
    assert [row["kind"] for row in rows] == ["background", "ball", "ball"]


X = make_transform(rotation_about([1, 2, 0], 1.0), [0.02, -0.03, 0.1])  # T_flange_sensor of the mount, metres
MOUNT = HandEyeRecord(T_flange_sensor=X.tolist())


def mounted(folder: Path, store: StageStore) -> None:
    """Write a mount, and a list of touches of a part at the base's origin by the mounted sensor."""
    write_mount(folder / "mount" / "mount.toml", MOUNT)
    lines = []
    localizer = Localizer.create(folder / "part.stl", units="mm", sensor="gelsight-mini", store=store)
    for touch in localizer.simulate(8, seed=5):
        write_touch(folder / f"{touch.name}.npz", touch)
        T_base_flange = np.linalg.inv(X @ touch.T_sensor_object)
        lines.append(f'[[touch]]\npath = "{touch.name}.npz"\nT_base_flange = {T_base_flange.tolist()}\n')
    (folder / "presses.toml").write_text("\n".join(lines))


@pytest.fixture(scope="module")
def furnished(tmp_path_factory, store) -> Path:
    """A folder with the files that the commands of the pages name."""
    folder = tmp_path_factory.mktemp("furnished")
    write_part(folder / "part.stl")
    localizer = Localizer.create(folder / "part.stl", units="mm", store=store, grid={"name": "face", "spacing_mm": 8})
    touches = [replace(t, T_base_sensor=np.linalg.inv(t.T_sensor_object)) for t in localizer.simulate(2, seed=3)]
    for name, touch in zip(("first", "second"), touches, strict=True):
        write_touch(folder / f"{name}.npz", touch)
    write_touch(folder / "touch.npz", localizer.simulate(1, seed=3)[0])
    (folder / "touches.toml").write_text('[[touch]]\npath = "first.npz"\n\n[[touch]]\npath = "second.npz"\n')
    mounted(folder, store)
    (folder / "touches").mkdir()
    write_touch(folder / "touches" / "0.npz", touches[0])
    pose = RosPose.of(np.asarray(touches[0].T_base_sensor), None)
    numbers = ",".join(map(str, (*pose.position_m, *pose.quaternion_xyzw)))
    (folder / "poses.csv").write_text(f"file,x_m,y_m,z_m,qx,qy,qz,qw\n0.npz,{numbers}\n")
    (frame,) = ImageFolder(folder / "touches", every=True).read_frames()
    (folder / "found.jsonl").write_text(json.dumps(LiveLocator(localizer).locate(frame).to_json()) + "\n")
    write_slide(folder / "drive.mcap", draw_random_slide(localizer, 3, seed=0))
    (folder / "poses.toml").write_text(
        "".join(
            f"[[approach]]\nT_sensor_next = {make_transform(np.eye(3), [x, 0, -0.05]).tolist()}\n"
            for x in (0.0, 0.005, 0.01)
        )  # behind the last touch and to its side
    )
    (folder / "parts").mkdir()
    shutil.copy(folder / "part.stl", folder / "parts")
    (folder / "prior.toml").write_text(
        'kind = "half-space"\nframe = "sensor"\nnormal = [0, 0, -1]\nplane_point_mm = [0, 0, 100]\n'
    )
    balls = ball_set(8)
    balls.write(folder / "FOLDER")
    for name in ("presses.csv", "sensor.toml"):  # the first command of the guide writes them
        (folder / "FOLDER" / name).unlink()
    balls.write(folder / "presses")  # with its labels
    (folder / "SET").mkdir()
    write_image(folder / "SET" / "background.png", balls.background)
    for number, (image, circle) in enumerate(zip(balls.images, balls.circles, strict=True)):
        (press := folder / "SET" / str(number)).mkdir()
        write_image(press / "gelsight.png", image)
        np.savez(press / "label.npz", center=circle[:2], radius=circle[2])
    write_image(folder / "untouched-today.png", balls.background)
    height, width = balls.background.shape[:2]
    matrix = [[2.0 * width, 0, width / 2], [0, 2.0 * width, height / 2], [0, 0, 1]]
    (folder / "camera.yaml").write_text(json.dumps({"K": matrix, "D": [-0.01, 0, 0, 0, 0]}))  # JSON is YAML
    write_image(folder / "photo.png", balls.images[0])
    (folder / "photos").mkdir()
    for number, image in enumerate(balls.images):
        write_image(folder / "photos" / f"{number}.png", image)
    (folder / "folder").mkdir()
    write_image(folder / "folder" / "photo.png", balls.images[1])
    return folder


@pytest.fixture
def workplace(furnished, tmp_path, monkeypatch, store) -> Path:
    shutil.copytree(furnished, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    return tmp_path


def test_each_toml_block_is_read_by_its_reader(tmp_path):
    write_mount(tmp_path / "mount" / "mount.toml", MOUNT)
    for page in PAGES:
        for text in (text for language, text in blocks(page) if language == "toml"):
            readers = [read for begins, read in READERS.items() if text.startswith(begins)]
            assert readers, f"{page} shows a TOML file that no test reads: {text[:40]}"
            (tmp_path / "block.toml").write_text(text)
            for named in re.findall(r"[\w-]+\.npz", text):
                write_touch(tmp_path / named, press_block().touch)
            readers[0](tmp_path / "block.toml")


def run(words: list[str]) -> None:
    """Run a command of a page with cheaper options; it must succeed."""
    if words[0] == "make":  # these take hours; the tests of the scripts run them briefly
        assert f"\n{words[1]}:" in (ROOT / "Makefile").read_text()
        return
    if words[0] == "python":
        assert (ROOT / words[1]).is_file()
        return
    assert words[0] == "tactile-loc", f"no test knows how to run {words[0]}"
    cheaper = CHEAPER.get(" ".join(words[1:3]), CHEAPER.get(words[1], []))
    if words[1] == "simulate" and "--together" in words:  # this gives the number of touches
        cheaper = COARSE
    if "--touches" in words:  # your own touches have their own number
        cheaper = [*COARSE, *SURE]
    if "moco" in words:
        cheaper = [*cheaper, *TINY_TRAINING]
    if "--ball-radius" in words:  # the ball of the furnished folders
        cheaper = [*cheaper, "--ball-radius", "3", "--mm-per-px", "0.25"]
    if "library" in words and words[1] == "identify":  # the grid of a library is fixed
        cheaper = ["-o", "temperature=0.05"]
    if words[1] in ("evaluate", "paper") and "--object" not in words:
        cheaper = [*cheaper, "--object", "pin", "--object", "head"]  # of the six
    done = CliRunner().invoke(app, [*words[1:], *cheaper], prog_name="tactile-loc")
    uncertain = done.exit_code == 3 and "--require" in words  # that is no fault of the page
    assert done.exit_code == 0 or uncertain, (words, done.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_commands_run(page, workplace):
    for words in commands(page):
        run(words)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if any(language == "python" for language, _ in blocks(page))])
def test_python_runs(page, workplace, monkeypatch, store):
    original = Localizer.create.__func__
    grid = (
        SEARCHED
        if page in ("next-touch.md", "identify.md", "stories.md")
        else {"grid": {"name": "face", "spacing_mm": 8.0}}
    )
    coarse = {"store": store, **grid}
    monkeypatch.setattr(Localizer, "create", classmethod(lambda cls, *a, **k: original(cls, *a, **{**k, **coarse})))
    for number, (language, text) in enumerate(blocks(page)):
        if language == "python":
            exec(compile(text, f"{page}, block {number}", "exec"), {})


@pytest.mark.slow
def test_the_script_of_two_fingers_finds_the_object(workplace):
    """The page's settings are used as they are, so that the search has the whole object."""
    (text,) = (text for language, text in blocks("control-loop.md") if language == "python")
    variables = {}
    exec(compile(text, "control-loop.md", "exec"), variables)
    found, truth = variables["found"], variables["T_base_object"]
    assert found.verdict is Verdict.CERTAIN
    assert len(variables["seconds"]) == 300
    assert variables["tracker"].latest() is found
    assert measure_pose_errors(variables["localizer"].object, found.T_base_object[None], truth)[0] < 1e-3
