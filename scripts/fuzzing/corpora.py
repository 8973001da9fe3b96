"""Files that are as they should be: what each reader's inputs are made from by damaging them."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace

STAGE = StageKey("fuzzed", 1, {"of": "nothing"})
SENSOR = """camera = "orthographic"
image_size_px = [48, 40]
mm_per_px = [0.4, 0.4]
max_depth_mm = 2.0
standoff_mm = 12.0
cx = 24.5
cy = 20.0
sensing_rectangle_mm = [-8.0, 8.0, -7.0, 7.0]
mask = "mask.png"
surface = "surface.npy"
"""
POSE = "[[0, 1, 0, 0.4], [1, 0, 0, 0.05], [0, 0, -1, 0.3], [0, 0, 0, 1]]"
TOUCH_LIST = f"""mount = "mount.toml"

[[touch]]
path = "touch.npz"
sensor = "sensor.toml"
T_base_flange = {POSE}
T_base_sensor_std_mm = 0.3

[[touch]]
path = "touch.npy"
unit = "mm"
press_depth_mm = 1.5
xyz_mm = [400.0, 50.0, 300.0]
rpy_deg = [180.0, 0.0, 90.0]

[[touch]]
path = "touch.png"
unit = "um"
T_base_sensor = {POSE}
T_base_sensor_std_deg = 0.5
"""
MOUNT = f"""T_flange_sensor = {POSE}
covariance = {json.dumps((1e-8 * np.eye(6)).tolist())}
T_base_object = {POSE}
object = "pin"
sensor = "gelslim"
variance_factor = 1.5

[[touch]]
name = "first"
residual_m = 0.0001
imprint_iou = 0.9
"""
PRIORS = {
    "gaussian.toml": f'kind = "gaussian"\nframe = "sensor"\nT = {POSE}\ntranslation_std_mm = 3.0\n'
    "rotation_std_deg = 20.0\n",
    "region.toml": 'kind = "region"\nframe = "base"\nlow_mm = [-inf, -20.0, 0.0]\nhigh_mm = [20.0, inf, 50.0]\n'
    "object_point_mm = [0.0, 1.0, 2.0]\n",
    "half-space.toml": 'kind = "half-space"\nframe = "sensor"\nnormal = [0.0, 0.0, 1.0]\n'
    "plane_point_mm = [0.0, 0.0, 10.0]\n",
}
CONFIGURATION = """top = 5
seed = 3
shape_px = 32
temperature = 0.1
coverage = 0.8

[object]
path = "pin"
units = "m"

[touch]
noise = "mild"
press_depth_mm = 1.0

[sensor]
name = "gelsight-mini"

[grid]
name = "face"
spacing_mm = 5.0

[refiner]
name = "icp"
"""
PLAN = """object = ["pin", {path = "hook", units = "m"}]
sensor = ["gelslim", {name = "digit"}]
refiner = ["none", "icp"]
noise = ["mild", "strong"]
seed = [0, 1]
count = 5
shape_px = 32
option = {grid = {spacing_mm = [4, 6]}}
"""
APPROACHES = f"""[[approach]]
name = "from above"
T_base_sensor = {POSE}
press_depth_mm = 1.0
travel_mm = 60.0
cost = 2.0

[[approach]]
T_sensor_next = {POSE}

[[approach]]
xyz_mm = [400.0, 0.0, 300.0]
quaternion_wxyz = [0.0, 1.0, 0.0, 0.0]
cost = inf
"""


def texts(**files: str) -> Callable[[Path], None]:
    """Return what writes text files, called by their names without a suffix, into a folder as TOML."""

    def write(folder: Path) -> None:
        for name, text in files.items():
            (folder / f"{name}.toml").write_text(text, encoding="utf-8")

    return write


def priors(folder: Path) -> None:
    """Write a prior of each kind."""
    for name, text in PRIORS.items():
        (folder / name).write_text(text, encoding="utf-8")


def mesh(suffix: str, **options: object) -> Callable[[Path], None]:
    """Return what writes a small part, without symmetry, as a file of that format."""

    def write(folder: Path) -> None:
        exported = _part().export(file_type=suffix, **options)
        if isinstance(exported, dict):  # a glTF with its buffers beside it
            for name, content in exported.items():
                (folder / name.replace("model", "part")).write_bytes(content)
            return
        content = exported.encode() if isinstance(exported, str) else exported
        (folder / f"part.{suffix.removesuffix('_ascii')}").write_bytes(content)

    return write


@cache
def _part():
    """A wedge on a plate, in mm: 24 faces."""
    import trimesh

    plate = trimesh.creation.box((30.0, 20.0, 4.0))
    wedge = trimesh.convex.convex_hull([[0, 0, 2], [9, 0, 2], [0, 5, 2], [0, 0, 8], [9, 0, 3], [0, 5, 5]])
    return trimesh.util.concatenate([plate, wedge])


def sensor(folder: Path) -> None:
    """Write a sensor, its mask and its surface."""
    from PIL import Image

    (folder / "sensor.toml").write_text(SENSOR, encoding="utf-8")
    mask = np.full((40, 48), 255, np.uint8)
    mask[:3] = 0
    Image.fromarray(mask).save(folder / "mask.png")
    np.save(folder / "surface.npy", np.linspace(0, 2e-4, 48, dtype=np.float32) * np.ones((40, 1), np.float32))


def _depth_m() -> np.ndarray:
    """What a sphere shows (40, 48), metres."""
    y, x = np.mgrid[:40, :48]
    return np.minimum(1e-6 * ((x - 20.0) ** 2 + (y - 18.0) ** 2) * 20, 2e-3).astype(np.float32)


def touches(folder: Path) -> None:
    """Write one touch in each of the formats, and the sensor that took it."""
    from PIL import Image

    sensor(folder)
    depth_m = _depth_m()
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    np.savez_compressed(
        folder / "touch.npz", depth=depth_m, unit=np.array("m"), press_depth=np.array(2e-3), indentation=np.array(2e-3),
        T_sensor_object=T, T_base_sensor=T,
    )  # fmt: skip
    np.save(folder / "touch.npy", 1e3 * depth_m)
    Image.fromarray(np.rint(1e6 * depth_m).astype(np.uint16)).save(folder / "touch.png")


def touch_list(folder: Path) -> None:
    """Write a list of touches, and all that it names."""
    touches(folder)
    texts(touches=TOUCH_LIST, mount=MOUNT)(folder)


def calibration(folder: Path) -> None:
    """Write a calibrated sensor that has learned nothing, and images for it to read."""
    from PIL import Image
    from press_sets import write_calibrated

    write_calibrated(folder / "sensor")
    image = np.array(Image.open(folder / "sensor" / "background.png"))
    image[20:30, 20:30] += 9
    Image.fromarray(image).save(folder / "photo.png")
    Image.fromarray(image).save(folder / "photo.jpg", quality=95)
    np.save(folder / "photo.npy", image)


def presses(folder: Path) -> None:
    """Write labelled presses of a ball, one of a mesh, and the sensor."""
    from press_sets import ball_set, write_table

    mesh("stl")(folder)
    balls = ball_set(3, px=32)
    balls.write(folder)
    pressed = {"image": "0000.png", "kind": "mesh", "mesh": "part.stl", "units": "mm", "press_mm": 0.5}
    zeros = dict.fromkeys(("x_mm", "y_mm", "roll_deg", "pitch_deg", "yaw_deg"), 0)
    write_table(folder, [*balls.rows(), {**pressed, **zeros}])


def weights(folder: Path) -> None:
    """Write the weights of a small encoder."""
    from safetensors.torch import save_file

    from tactile_loc.plugins.encoders.moco.encoder import MocoEncoder

    network = MocoEncoder(MocoEncoder.Options(channels=8))._fresh_network(0)
    save_file(network.state_dict(), folder / "encoder.safetensors")


def make_stage(work: Workspace) -> None:
    """Build an artifact of each kind of file."""
    work.save_array("mapped", np.arange(30.0))
    work.save_array("packed", np.arange(40), packed=True)
    work.save_json("sizes", [3, 4])


def artifact(folder: Path) -> None:
    """Write a store that holds one artifact, of each kind of file."""
    from tactile_loc.store.store import StageStore

    StageStore(folder).build(STAGE, make_stage)


def result(folder: Path) -> None:
    """Locate a simulated touch, and write the result and some approaches."""
    from report_helpers import write_run

    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.store.store import StageStore

    sensor(folder)
    chosen = {"name": "file", "path": str(folder / "sensor.toml")}
    grid = {"name": "face", "spacing_mm": 8}
    store = StageStore(folder / "store")
    settings = {"grid": grid, "sensor": chosen, "shape_px": 32, "top": 3, "temperature": 0.1}
    write_run(folder, Localizer.create("pin", store=store, **settings))
    texts(approaches=APPROACHES.replace("T_base_sensor", "T_sensor_next").split("[[approach]]\nxyz")[0])(folder)
    for name in ("sensor.toml", "mask.png", "surface.npy"):
        (folder / name).unlink()


def evaluation(folder: Path) -> None:
    """Write the files of an evaluation."""
    from report_helpers import write_evaluation

    write_evaluation(folder, touches=5)


def contacts(folder: Path) -> None:
    """Write the files of an evaluation from several contacts."""
    from report_helpers import write_contacts

    write_contacts(folder)


def sweep(folder: Path) -> None:
    """Write the table of a sweep."""
    from report_helpers import sweep_rows, write_sweep

    from tactile_loc.io.config import RunConfig

    def configured(row: dict[str, Any]) -> dict[str, Any]:
        grid = {"name": "face", "spacing_mm": row["grid.spacing_mm"]}
        config = RunConfig.from_dict({"object": {"path": row["object"]}, "grid": grid, "refiner": row["refiner"]})
        return {**row, "configuration": config.model_dump(mode="json")}

    write_sweep(folder, [configured(row) for row in sweep_rows()])


def _images() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (3, 6, 8, 3), np.uint8)


def mcap(folder: Path) -> None:
    """Write a recording of images and transforms."""
    from tactile_loc.io.recordings import RecordingWriter, write_recording
    from tactile_loc.io.ros_messages import IMAGE, TF, make_image, make_transforms

    def fill(writer: RecordingWriter) -> None:
        writer.write("/tf_static", TF, make_transforms({("flange", "gel"): np.eye(4)}, 0), 0)
        for k, image in enumerate(_images()):
            writer.write("/gel/image", IMAGE, make_image(image, "rgb8", k, "gel"), k)

    write_recording(folder / "drive.mcap", fill)


def bag1(folder: Path) -> None:
    """Write a bag of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    from tactile_loc.io.ros_messages import IMAGE, make_image

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(folder / "drive.bag") as writer:
        connection = writer.add_connection("/gel/image", IMAGE, typestore=store)
        for k, image in enumerate(_images()):
            message = make_image(image, "rgb8", k, "gel")
            stamp = store.types["builtin_interfaces/msg/Time"](k, 7)
            message.header = store.types["std_msgs/msg/Header"](k, stamp, "gel")
            writer.write(connection, k, store.serialize_ros1(message, IMAGE))


def bag2(folder: Path) -> None:
    """Write the folder of a bag of ROS 2."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    from tactile_loc.io.ros_messages import IMAGE, make_image

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder / "drive", version=9) as writer:
        connection = writer.add_connection("/gel/image", IMAGE, typestore=store)
        for k, image in enumerate(_images()):
            writer.write(connection, k, store.serialize_cdr(make_image(image, "rgb8", k, "gel"), IMAGE))


def video(folder: Path) -> None:
    """Write a short film of a touch, as GIF."""
    from PIL import Image

    frames = np.full((12, 24, 32, 3), 90, np.uint8)
    frames[5:8, 8:16, 8:16] = 200
    first, *others = (Image.fromarray(frame) for frame in frames)
    first.save(folder / "film.gif", save_all=True, append_images=others, duration=50)


def public_sets(folder: Path) -> None:
    """Write presses in each of the public formats that are converted."""
    from PIL import Image

    def picture(path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(_images()[0]).save(path)

    gs_sdk, fots, circles = (folder / name for name in ("gs_sdk", "fots", "circles"))
    for path in (gs_sdk / "background.png", gs_sdk / "1" / "gelsight.png", fots / "gelsight" / "a.png"):
        picture(path)
    for path in (circles / "background.png", circles / "b.png"):
        picture(path)
    np.savez(gs_sdk / "1" / "label.npz", center=np.array([3.0, 4.0]), radius=np.array(2.0))
    centres, radii = np.full((3, 2), 3.0), np.full(3, 2.0)
    np.savez(folder / "taxim.npz", imgs=_images(), f0=_images()[0], touch_center=centres, touch_radius=radii)
    (fots / "csv").mkdir()
    (fots / "csv" / "annotate.csv").write_text("img_names,center_x,center_y,radius\na.png,3,4,2\n")
    (circles / "labels.txt").write_text("b.png (3.0, 4.0) 2.0\n")
