"""The pages on benchmarks: the leaderboard matches its files, and the method of the page is a method."""

import importlib
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import leaderboard
import numpy as np
import pytest
from bench_fakes import offer_fakes
from bench_parts import SENSOR, Archive
from message_helpers import missing
from tactile_loc import RobotTouches
from tactile_loc.plugin import SensorGeometry, registry
from tactile_loc.plugin.helpers import invert, make_contact_cloud, transform_points
from tactile_loc.testing.problems import ReferenceRenderer
from tactile_loc_cli.main import app
from typer.main import get_command
from typer.testing import CliRunner

from tactile_loc_benchmark.files import read_rows
from tactile_loc_benchmark.interfaces import LocatingProblem
from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.leaderboard import read_standings
from tactile_loc_benchmark.suite import Suite

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "benchmark.md").read_text()
FILES = sorted(leaderboard.RESULTS.glob("*.json"))


def find_blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def find_file(name: str) -> str:
    shown = re.search(rf"^`{re.escape(name)}`\n\n```\w+\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert shown
    return shown[1]


def test_the_leaderboard_matches_the_committed_results():
    assert FILES
    assert leaderboard.PAGE.read_text() == leaderboard.format_page(leaderboard.read_all()), "run docs/leaderboard.py"
    assert leaderboard.fill_guide(PAGE) == PAGE, "run docs/leaderboard.py"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_committed_results_contain_no_paths(path):
    assert not re.search(r"(/[\w.-]+){2}", path.read_text())


@pytest.fixture
def standings() -> list[Row]:
    """Standings of the default tactile-loc, with the same shares for all numbers of touches."""
    return [one for one in read_standings(FILES[0]) if one["component"] == leaderboard.OURS and not one["options"]]


def write_rival(folder: Path, share: float, **changes: object) -> Path:
    """Write the committed results, with those of a rival that has another share within 1 mm."""
    document = json.loads(FILES[0].read_text())
    methods = document["methods"].items()
    ours = [name for name, method in methods if method["name"] == leaderboard.OURS and not method["options"]]
    document["groups"] = [group for group in document["groups"] if group["method"] in ours]
    document["methods"] = {"rival": {"name": "rival", "options": {}, "paper": "Rival et al.", "libraries": {"r": "2"}}}
    for group in document["groups"]:
        group |= {"method": "rival", "within": [share] * 4, "within_range": [[share, share]] * 4}
    for source in document["sources"].values():
        source |= {key: value for key, value in changes.items() if key in source}
    path = folder / "rival.json"
    path.write_text(json.dumps(document | {key: value for key, value in changes.items() if key in document}))
    return path


def test_a_better_rival_is_bold_and_listed_as_a_loss_and_a_worse_one_is_not(standings, tmp_path):
    rival = list(read_standings(write_rival(tmp_path, 1.0)))
    text = leaderboard.format_page([*standings, *rival])
    losses = text.split("## Suite")[0]
    worse = [one for one in standings if one["within"][leaderboard.NEAR] < 1]
    assert losses.count("| rival |") == len(worse) > 0
    assert "**100 % (100 to 100)**" in text
    assert "Rival et al." in text
    assert len(re.findall(r"^### ", text, re.MULTILINE)) == len({one["source"] for one in standings})
    worse = list(read_standings(write_rival(tmp_path, 0.0)))
    assert "| rival |" not in leaderboard.format_page([*standings, *worse]).split("## Suite")[0]


def test_results_of_another_protocol_have_a_table_of_their_own(standings, tmp_path):
    rival = list(read_standings(write_rival(tmp_path, 1.0, protocol="another")))
    text = leaderboard.format_page([*standings, *rival])
    assert not missing(text, "Protocol: `another`")
    assert len(re.findall(r"^### ", text, re.MULTILINE)) == 2 * len({one["source"] for one in standings})
    assert "| rival |" not in text.split("## Suite")[0], "they cannot be compared"


def test_the_newest_result_counts(tmp_path):
    for folder, date in (("new", "2030-01-01"), ("old", "2020-01-01")):
        (tmp_path / folder).mkdir()
        path = write_rival(tmp_path / folder, 1.0 if folder == "new" else 0.0, created=f"{date}T00:00:00+00:00")
        path.rename(tmp_path / f"{folder}.json")
    found = leaderboard.read_all(tmp_path)
    assert {one["date"] for one in found} == {"2030-01-01"}
    assert {one["within"][0] for one in found} == {1.0}


@pytest.fixture
def lowest_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The page's method as pip would install it, and a small sensor."""
    site = tmp_path / "site"
    with offer_fakes(site):
        (site / "lowest_point.py").write_text(find_file("lowest_point.py"))
        info = site / "lowest_point-0.1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lowest-point\nVersion: 0.1.0\n")
        points = re.search(r"^\[project\.entry-points\.tactile_loc\]\n(.*)$", find_file("pyproject.toml"), re.MULTILINE)
        assert points
        (info / "entry_points.txt").write_text(f"[tactile_loc]\n{points[1].replace(chr(34), '')}\n")
        importlib.invalidate_caches()
        registry.cache_clear()
        (tmp_path / "flat.toml").write_text(SENSOR)
        monkeypatch.chdir(tmp_path)
        yield tmp_path


def test_the_method_of_the_page_puts_the_object_s_lowest_point_where_the_touch_is_deepest():
    found: dict[str, Any] = {}
    exec(find_file("lowest_point.py"), found)
    box = Archive().find_objects()["brick"]
    geometry = SensorGeometry("orthographic", 64, 48, 3e3, 3e3, 32, 24, 0.01, 2e-3)
    (touch,), _ = RobotTouches(box, geometry, ReferenceRenderer()).draw_example(1, np.random.default_rng(0))
    answer = found["LowestPoint"]().locate(LocatingProblem(box, {}, geometry, Path()), [touch])
    T_sensor_object = invert(np.asarray(touch.T_base_sensor)) @ answer.T_base_object
    for pose in T_sensor_object:
        lowest_m = transform_points(pose, box.mesh.vertices_m)[:, 2].min()
        assert lowest_m == pytest.approx(touch.geometry.standoff_m, abs=geometry.pixel_pitch_m)
    assert touch.indentation_m > 2 * geometry.pixel_pitch_m
    points_m, _ = make_contact_cloud(touch.touching_shape, touch.geometry, walls=False)
    contact = touch.touching_shape.contact & geometry.observed_mask
    by_hand = geometry.standoff_m - touch.indentation_m + touch.touching_shape.depth_m[contact]
    np.testing.assert_allclose(points_m[:, 2], by_hand, atol=1e-8)


@pytest.mark.slow
def test_the_method_of_the_page_appears_in_the_table(lowest_point):
    suite = 'name = "tiny"\nobjects = [{path = "pin", symmetry = "none"}]\ntouches = [1]\nexamples = 2\nseed = 1\n'
    (lowest_point / "tiny.toml").write_text(f'{suite}[[source]]\nname = "sketch"\n[[method]]\nname = "oracle"\n')
    words = ["benchmark", "--suite", "tiny.toml", "--method", "lowest-point", "--workers", "1", "--store", "store"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "lowest-point" in done.output
    rows = read_rows(Path("benchmark/rows.parquet"))
    assert {(row["method"], row["problem"]) for row in rows} == {("lowest-point", "")}


def test_the_suite_of_the_page_can_be_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in find_blocks("toml") if "[[source]]" in block)
    (tmp_path / "mine.toml").write_text(block)
    suite = Suite.from_toml("mine.toml")
    assert [entry.label for entry in suite.method] == ["tactile-loc", "tactile-loc, ICP"]


def test_every_command_has_the_options_it_is_given():
    known = {flag for option in get_command(app).commands["benchmark"].params for flag in option.opts}
    lines = re.findall(r"tactile-loc benchmark[^`\n]*", PAGE)
    assert len(lines) > 3
    used = {word for line in lines for word in shlex.split(line)}
    assert {word for word in used if word.startswith("--")} <= known
