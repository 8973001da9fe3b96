"""`tactile-loc replay-dataset`: the results of simulated touches as columns, and the example of the README."""

import os
import re
import subprocess
import sys
from pathlib import Path

import datasets
import numpy as np
import pytest
from tactile_loc import Localizer, RosPose

OBJECT = ["--object", "pin", "--grid", "face", "--option", "grid.spacing_mm=10", "--option", "temperature=1e-3"]
README = Path(__file__).parents[1] / "README.md"


@pytest.fixture(scope="module")
def touches() -> tuple[Localizer, list]:
    localizer = Localizer.create("pin", grid={"name": "face", "spacing_mm": 10}, temperature=1e-3)
    return localizer, localizer.simulate(2, seed=2)


@pytest.fixture
def depths(touches, tmp_path) -> Path:
    """A data set of depths: two touches, and between them an untouched gel."""
    shapes = [touch.contact_shape.depth_m for touch in touches[1]]
    shapes.insert(1, np.full_like(shapes[0], 0.002))
    features = datasets.Features({"depth": datasets.Array2D(shapes[0].shape, "float32")})
    datasets.Dataset.from_dict({"depth": shapes}, features).to_parquet(tmp_path / "depths.parquet")
    return tmp_path / "depths.parquet"


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from tactile_loc_cli.main import main; main()", "replay-dataset", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_poses_covariances_and_verdicts_are_columns(depths, touches, tmp_path):
    done = run(tmp_path, "depths.parquet", "--column", "depth", "--press-depth", "2", *OBJECT, "--out", "out.parquet")
    assert done.returncode == 0, done.stderr
    written = datasets.Dataset.from_parquet(str(tmp_path / "out.parquet"), cache_dir=str(tmp_path / "cache"))
    localizer, (first, _) = touches
    expected = localizer.localize(first)
    pose = RosPose.of(expected.best.T_sensor_object, None)
    np.testing.assert_allclose(written[0]["object_pose"][:3], pose.position_m, atol=1e-4)
    assert abs(np.dot(written[0]["object_pose"][3:], pose.quaternion_xyzw)) == pytest.approx(1, abs=1e-4)
    assert written[0]["object_verdict"] == expected.verdict.value
    assert written[0]["object_probability"] == pytest.approx(expected.best.probability, abs=1e-3)
    C = np.reshape(written[0]["object_covariance"], (6, 6))
    np.testing.assert_allclose(C, expected.best.covariance, rtol=0.05, atol=1e-9)
    assert written[1]["object_verdict"] == "no contact"
    assert written[1]["object_pose"] is written[1]["object_covariance"] is None


def test_mistakes_are_one_sentence_and_write_nothing(depths, tmp_path):
    for words in (["--out", "out.csv"], ["--column", "dept"], ["--poses", "poses.csv"], ["--turn", "0"]):
        done = run(tmp_path, "depths.parquet", *words, *OBJECT)
        assert done.returncode == 2
        assert done.stderr.startswith("error: ")
        assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["depths.parquet"]


@pytest.mark.skipif(not README.is_file(), reason="only the package is installed, without its README")
def test_the_example_of_the_readme_runs(tmp_path):
    pages = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    (tmp_path / "example.py").write_text("\n".join(pages))
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [sys.executable, "example.py"], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "certain" in done.stdout or "ambiguous" in done.stdout
