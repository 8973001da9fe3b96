"""The files that ROS 2 reads: package.xml, the parameter file, and the launch file."""

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from tactile_loc import TactileLocError

import tactile_loc_ros2
from tactile_loc_ros2.options import OPTIONS, NodeOptions, read_text

SITE = Path(tactile_loc_ros2.__file__).parents[1]
NAMES = [one.name for one in OPTIONS]


def find_file(name: str) -> Path:
    """Return a file of the sources or, if only the package is installed, of its shared folder."""
    (found, *_) = [path for path in (SITE / name, SITE / "share" / "tactile_loc_ros2" / name) if path.exists()]
    return found


def test_package_xml_depends_on_all_packages_of_ros_that_are_used():
    root = ElementTree.parse(find_file("package.xml")).getroot()
    assert root.findtext("name") == "tactile_loc_ros2"
    assert root.findtext("export/build_type") == "ament_python"
    sources = [path.read_text() for path in Path(tactile_loc_ros2.__file__).parent.glob("*.py")]
    text = "\n".join([*sources, find_file("launch/tactile_loc.launch.py").read_text()])
    used = set(re.findall(r"[\"'](\w+)/(?:msg|srv)/", text)) | set(re.findall(r"import_ros\(\"(\w+)", text))
    used |= set(re.findall(r"^from (launch\w*)", text, re.MULTILINE))
    assert {"rclpy", "std_srvs", "tf2_msgs", "launch_ros"} < used
    assert {one.text for one in root.findall("exec_depend")} == used


def test_the_parameter_file_sets_known_options():
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: pip install pyyaml")
    (parameters,) = yaml.safe_load(find_file("config/tactile_loc.yaml").read_text()).values()
    NodeOptions.of(parameters["ros__parameters"])  # refuses unknown names and impossible values
    text = find_file("config/tactile_loc.yaml").read_text()
    in_comments = re.findall(r"^    # (\w+): ", text, re.MULTILINE)
    assert {"base_frame", "mesh_scale", "library"} < set(in_comments) <= set(NAMES)


def test_the_readme_lists_each_option_with_its_default():
    readme = SITE / "README.md"
    if not readme.exists():
        pytest.skip("only the package is installed, without its README")
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+?) \| ", readme.read_text(), re.MULTILINE))
    for one in OPTIONS:
        default = str(one.default).lower() if isinstance(one.default, bool) else str(one.default)
        assert rows[one.name] == ("none" if one.default in ("", ()) else f"`{default}`"), one.name


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Run the launch file with substitutes for the parts of `launch` that it uses."""

    def describe_argument(name: str, default_value: str, description: str) -> SimpleNamespace:
        return SimpleNamespace(name=name, default_value=default_value, description=description)

    def find_value(name: str) -> SimpleNamespace:
        return SimpleNamespace(perform=lambda context: context.get(name, ""))

    modules = {
        "launch": {"LaunchContext": dict, "LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": describe_argument, "OpaqueFunction": SimpleNamespace},
        "launch.substitutions": {"LaunchConfiguration": find_value},
        "launch_ros": {}, "launch_ros.actions": {"Node": SimpleNamespace},
    }  # fmt: skip
    for name, things in modules.items():
        module = ModuleType(name)
        module.__dict__.update(things)
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(find_file("launch/tactile_loc.launch.py")))


def test_each_option_is_an_argument_of_the_launch_file(launch_file):
    *arguments, opaque = launch_file["generate_launch_description"]()
    assert {argument.name for argument in arguments} == {*NAMES, "params_file", "namespace", "name"}
    assert {argument.default_value for argument in arguments} == {""}
    assert all(argument.description for argument in arguments)
    assert opaque.function is launch_file["start_node"]


def test_the_launch_file_passes_only_given_arguments(launch_file):
    given = {"params_file": "my.yaml", "track": "true", "most_touches": "3", "tf_wait_s": "1", "library": "a.stl, b"}
    (node,) = launch_file["start_node"](given)
    chosen = {"track": True, "most_touches": 3, "tf_wait_s": 1.0, "library": ["a.stl", "b"]}
    assert (node.package, node.executable, node.name) == ("tactile_loc_ros2", "tactile-loc-ros2", "tactile_loc")
    assert node.parameters == ["my.yaml", chosen]
    (plain,) = launch_file["start_node"]({"name": "left"})
    assert (plain.name, plain.parameters) == ("left", [])


def test_the_launch_file_loads_with_ros():
    launch = pytest.importorskip("launch", reason="launch, which is part of ROS 2, is not installed")
    pytest.importorskip("launch_ros", reason="launch_ros, which is part of ROS 2, is not installed")
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    description = get_launch_description_from_python_launch_file(str(find_file("launch/tactile_loc.launch.py")))
    assert isinstance(description, launch.LaunchDescription)
    assert {argument.name for argument in description.get_launch_arguments()} >= set(NAMES)


@pytest.mark.parametrize(("name", "text"), [("track", "perhaps"), ("most_touches", "many"), ("tf_wait_s", "long")])
def test_texts_of_another_type_are_refused(name, text):
    (one,) = [one for one in OPTIONS if one.name == name]
    with pytest.raises(TactileLocError, match=name):
        read_text(one, text)
