"""`tactile-loc run` with a list of touches, and with a prior."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, assert_refused, succeed
from message_helpers import missing

OBJECT = ["--object", "pin", *TINY]


def write_list(cli, count: int, seed: int, moved: int | None = None) -> dict[str, np.ndarray]:
    """Write a list of simulated touches, with the sensor pose of one wrong by 8 mm; return their poses by name."""
    assert cli("simulate", *OBJECT, "--count", count, "--seed", seed, "--out", "touches").exit_code == 0
    poses = json.loads(Path("touches/poses.json").read_text())["T_sensor_object"]
    text = ""
    for number, (name, T) in enumerate(poses.items()):
        T_base_sensor = np.linalg.inv(T)
        if number == moved:
            T_base_sensor[:3, 3] += T_base_sensor[:3, 0] * 8e-3
        text += f'[[touch]]\npath = "touches/{name}.npz"\nT_base_sensor = {T_base_sensor.tolist()}\n'
    Path("touches.toml").write_text(text)
    return {name: np.array(T) for name, T in poses.items()}


@pytest.fixture
def listed(cli):
    """Write a list of two simulated touches of a fixed object, and return their poses."""
    return write_list(cli, count=2, seed=3)


@pytest.fixture
def one_moved(cli):
    """Write a list of four touches with the sensor pose of the third wrong by 8 mm; return the name of the third."""
    names = list(write_list(cli, count=4, seed=1, moved=2))
    return f"{names[2]}.npz"


def prior(kind: str = "gaussian", **keys: object) -> Path:
    lines = [f"{key} = {json.dumps(value)}" for key, value in {"kind": kind, "frame": "sensor", **keys}.items()]
    Path("prior.toml").write_text("\n".join(lines) + "\n")
    return Path("prior.toml")


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_several_touches_are_fused(cli, listed):
    succeed(cli("run", *OBJECT, "--touch", "touches.toml", "--out", "both"))
    first = next(iter(listed))
    succeed(cli("run", *OBJECT, "--touch", f"touches/{first}.npz", "--out", "one"))
    both, one = (json.loads(Path(out, "result.json").read_text()) for out in ("both", "one"))
    assert [t["name"] for t in both["other_touches"]] == [f"{name}.npz" for name in list(listed)[1:]]
    assert both["other_touches"][0]["T_base_sensor"] is not None
    assert one["other_touches"] == []
    assert (len(both["hypotheses"][0]["imprint_ious"]), len(one["hypotheses"][0]["imprint_ious"])) == (2, 1)
    assert both["errors"]["best_m"] < 6e-3
    assert Path("both/result.png").is_file()


@pytest.mark.slow
def test_touches_of_different_sensors_are_fused(cli, listed):
    size = ["-o", "sensor.image_size_px=[120, 120]"]
    assert cli("simulate", *OBJECT, *size, "--count", 1, "--seed", 9, "--out", "small").exit_code == 0
    (T,) = json.loads(Path("small/poses.json").read_text())["T_sensor_object"].values()
    Path("small.toml").write_text(
        'camera = "pinhole"\nimage_size_px = [120, 120]\nfx = 74.4\nfy = 73.8\ncx = 60.0\ncy = 60.0\n'
        "standoff_mm = 25.0\nmax_depth_mm = 2.0\n"
    )
    with Path("touches.toml").open("a") as file:
        file.write('[[touch]]\npath = "small/touch-0000.npz"\nsensor = "small.toml"\n')
        file.write(f"T_base_sensor = {np.linalg.inv(T).tolist()}\n")
    succeed(cli("run", *OBJECT, "--touch", "touches.toml", "--out", "out"))
    sizes = [t["image_px"] for t in json.loads(Path("out/result.json").read_text())["other_touches"]]
    assert sizes == [[200, 200], [120, 120]]


def test_one_touch_with_a_sensor_pose_is_located_in_the_base_frame(cli, listed):
    """The list has one touch. The table, and the report's next touch, are in the frame of T_base_sensor."""
    first = Path("touches.toml").read_text().split("[[touch]]")[1]
    Path("one.toml").write_text(f"[[touch]]{first}")
    done = succeed(cli("run", *OBJECT, "--touch", "one.toml", "--out", "out"))
    assert not missing(done.stdout, "base frame", "about the base's x, y and z axes")
    best = json.loads(Path("out/result.json").read_text())["hypotheses"][0]
    x_mm = f"{1e3 * best['T_base_object'][0][3]:z.2f}"
    assert x_mm in done.stdout
    np.testing.assert_allclose(
        best["T_base_object"], np.linalg.inv(next(iter(listed.values()))) @ best["T_sensor_object"], atol=1e-9
    )


def test_a_prior_reduces_the_entropy_of_an_ambiguous_touch(cli, listed):
    name, T = next(iter(listed.items()))
    file = prior(T=T.tolist(), translation_std_mm=2, rotation_std_deg=5)
    entropies = []
    for more in ([], ["--prior", file]):
        succeed(cli("run", *OBJECT, "--touch", f"touches/{name}.npz", *more, "--out", "out"))
        result = json.loads(Path("out/result.json").read_text())
        entropies.append(result["entropy_nats"])
    assert entropies[1] < entropies[0]
    assert result["errors"]["best_m"] < 6e-3


def test_a_touch_ranks_the_poses_of_a_list(cli, listed):
    name, T = next(iter(listed.items()))
    turned = T @ np.diag([1.0, -1.0, -1.0, 1.0])
    file = prior("hypotheses", poses="poses.npz", translation_std_mm=2, rotation_std_deg=5)
    run = ["run", *OBJECT, "--touch", f"touches/{name}.npz", "--prior", file, "--out", "out", "--json"]
    np.savez("poses.npz", poses=np.array([turned, T]), scores=np.array([0.6, 0.4]))
    ranked = json.loads(succeed(cli(*run)).stdout)["listed_poses"]
    assert [one["before"] for one in ranked] == pytest.approx([0.6, 0.4])
    assert ranked[1]["after"] > 0.9
    far = T.copy()
    far[:3, 3] += 1.0
    np.savez("poses.npz", poses=far[None], scores=np.ones(1))
    done = succeed(cli(*run))
    assert json.loads(done.stdout)["listed_poses"][0]["after"] < 0.5
    assert "prior.toml" in done.stderr


def test_bad_lists_and_priors_are_one_sentence(cli, listed):
    name = next(iter(listed))
    Path("lost.toml").write_text('[[touch]]\npath = "lost.npz"\n')
    assert_refused(cli("run", *OBJECT, "--touch", "lost.toml", "--out", "out"), "lost.toml", "touch 1")
    based = prior(frame="base", T=np.eye(4).tolist(), translation_std_mm=2)
    touch = ["--touch", f"touches/{name}.npz"]
    assert_refused(cli("run", *OBJECT, *touch, "--prior", based, "--out", "out"), "prior.toml", "T_base_sensor")
    assert_refused(cli("run", *OBJECT, "--touch", "touches", "--prior", based, "--out", "out"), "--prior")
    assert not Path("out").exists()


@pytest.mark.slow
def test_an_outlier_is_named_and_can_be_dropped(cli, one_moved):
    # no temperature is fitted, and eight hypotheses are enough for an easy example
    Path("run.toml").write_text("temperature = 1e-3\nhypotheses.refined_together = 8\n")
    several = ["run", *OBJECT, "--config", "run.toml", "--touch", "touches.toml", "--report"]
    done = succeed(cli(*several, "--out", "all"))
    assert not missing(done.stderr, "3 of 4", one_moved, "--drop-outliers")
    result = json.loads(Path("all/result.json").read_text())
    touches = [result["touch"], *result["other_touches"]]
    assert [touch["outlier"] for touch in touches] == [False, False, True, False]
    assert len(result["hypotheses"][0]["imprint_ious"]) == 4
    assert result["contradictory"]
    page = Path("all/report.html").read_text()
    assert len(re.findall(r"contradicts[^<]*</strong>", page)) == 1
    assert not missing(page, "3 of 4", one_moved)

    dropped = succeed(cli(*several, "--drop-outliers", "--out", "dropped"))
    assert one_moved in dropped.stderr
    result = json.loads(Path("dropped/result.json").read_text())
    assert [touch["name"] for touch in result["left_out"]] == [one_moved]
    assert one_moved not in [touch["name"] for touch in (result["touch"], *result["other_touches"])]
    assert not result["contradictory"]
    assert result["configuration"]["drop_outliers"]
    assert one_moved in Path("dropped/report.html").read_text()


def test_dropping_outliers_requires_a_list_of_touches(cli, listed):
    name = next(iter(listed))
    for touch in ([], ["--touch", f"touches/{name}.npz"], ["--touch", "touches"]):
        assert_refused(cli("run", *OBJECT, *touch, "--drop-outliers", "--out", "out"), "--drop-outliers", "list")
    assert not Path("out").exists()
