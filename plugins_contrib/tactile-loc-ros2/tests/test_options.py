"""Options: the command line, ROS arguments, defaults, and refused values."""

from dataclasses import replace

import numpy as np
import pytest
from tactile_loc import TactileLocError, Verdict

from tactile_loc_ros2.options import NodeOptions, choose_sensor, make_parser, read_camera, split_arguments

LEAST = {"object": "pin", "sensor": "gelslim", "image_topic": "/gel"}


def parse(*words: str) -> NodeOptions:
    given = vars(make_parser().parse_args(["--object", "pin", "--sensor", "gelslim", "--image-topic", "/gel", *words]))
    return NodeOptions.of(given)


def test_the_command_line_sets_every_kind_of_option():
    options = parse(
        "--track", "--no-continuous", "--press-depth", "1.5", "--most-touches", "3", "--require", "certain",
        "--library", "a.stl", "b.stl", "--tf", "any",
    )  # fmt: skip
    assert (options.track, options.continuous, options.most_touches) == (True, False, 3)
    assert options.press_depth_m == pytest.approx(1.5e-3)
    assert options.required is Verdict.CERTAIN
    assert options.library == ("a.stl", "b.stl")
    assert parse().press_depth_m is None
    assert parse().required is None


@pytest.mark.parametrize("words", [["--require", "perhaps"], ["--requir", "certain"], ["--most-touches", "many"]])
def test_wrong_words_are_refused(words, capsys):
    with pytest.raises(SystemExit):
        parse(*words)
    assert words[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "mentioned"),
    [
        ({"image_topic": ""}, "image_topic"),
        ({"object": ""}, "object and sensor"),
        ({"sensor": ""}, "object and sensor"),
        ({"require": "ambiguous"}, "require"),
        ({"units": "furlong"}, "units"),
        ({"tf": "sometimes"}, "tf"),
        ({"tf": "any", "object_frame": ""}, "object_frame"),
        ({"press_depth_mm": -1.0}, "press_depth_mm"),
        ({"tf_keep_s": float("nan")}, "tf_keep_s"),
        ({"most_touches": 0}, "most_touches"),
    ],
)
def test_impossible_values_are_refused(change, mentioned):
    with pytest.raises(TactileLocError, match=mentioned):
        NodeOptions(**{**LEAST, **change})


def test_an_empty_text_stands_for_an_empty_list():
    assert NodeOptions.of({**LEAST, "library": [""]}).library == ()
    assert NodeOptions.of({**LEAST, "library": ["a.stl"]}).library == ("a.stl",)


def test_ros_gets_its_own_arguments():
    words = ["--object", "pin", "--ros-args", "-r", "__ns:=/left", "--", "--track", "--ros-args", "-p", "tf:=any"]
    ours, of_ros = split_arguments(words)
    assert ours == ["--object", "pin", "--track"]
    assert of_ros == ["--ros-args", "-r", "__ns:=/left", "--", "--ros-args", "-p", "tf:=any"]
    assert split_arguments([]) == ([], [])


def test_a_sensor_may_be_a_name_a_file_or_a_folder(tmp_path):
    assert choose_sensor("gelslim") == "gelslim"
    assert choose_sensor("my.toml") == {"name": "file", "options": {"path": "my.toml"}}
    assert choose_sensor(str(tmp_path))["name"] == "calibrated"


def test_camera_info_replaces_the_rays_of_the_sensor(types):
    make = types.find("sensor_msgs/msg/CameraInfo")
    K = np.array([300.0, 0, 60, 0, 310, 50, 0, 0, 1])
    message = types.pass_on(make(width=120, height=100, k=K))
    localizer, others = NodeOptions(**{**LEAST, "library": ("head",)}).make_localizers(message)
    for one in (localizer, *others):
        camera = one.sensor.geometry
        assert (camera.shape, camera.fx, camera.fy, camera.cx, camera.cy) == ((100, 120), 300, 310, 60, 50)
        assert (camera.standoff_m, camera.max_depth_m) == pytest.approx((25e-3, 2e-3))
    P = np.array([280.0, 0, 61, 0, 0, 290, 51, 0, 0, 0, 1, 0])
    rectified = read_camera(types.pass_on(make(width=120, height=100, k=K, p=P)), localizer.sensor.geometry)
    assert (rectified.fx, rectified.fy, rectified.cx, rectified.cy) == (280, 290, 61, 51)
    with pytest.raises(TactileLocError, match="fx"):
        NodeOptions(**LEAST).make_localizers(types.pass_on(make(width=120, height=100)))


def test_a_configuration_gives_all_other_settings(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(
        'temperature = 1e-3\n[object]\npath = "pin"\n[sensor]\nname = "digit"\n[grid]\nname = "face"\nspacing_mm = 8\n'
        '[tracker]\nmodes = 3\n[touch]\nkind = "indentation"\n'
    )
    options = NodeOptions(config=str(file), image_topic="/gel", tolerance="0.5mm,2deg", confidence=0.99)
    localizer, library = options.make_localizers()
    config = localizer.config
    assert (config.object.path, config.sensor.name, config.tracker.modes, library) == ("pin", "digit", 3, [])
    assert config.grid.options["spacing_mm"] == 8
    assert config.touch.kind == "indentation"
    assert config.tolerance.distance_m == pytest.approx(5e-4)
    assert config.confidence == 0.99
    other, _ = replace(options, object="head", sensor="gelslim").make_localizers()
    assert (other.object.name, other.config.sensor.name) == ("head", "gelslim")
