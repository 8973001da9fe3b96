"""Correct files, which are then damaged. The folder `whole` has the TOML files."""

import json
import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from press_sets import ball_set, write_calibrated
from public_sets import PUBLIC_SETS
from report_helpers import write_run, write_sweep

from tactile_loc import Localizer, StageKey, StageStore
from tactile_loc.io.streams.recordings import RecordingWriter, write_recording
from tactile_loc.io.streams.ros_messages import (
    CDR,
    COMPRESSED_IMAGE,
    IMAGE,
    TF,
    load_types,
    make_header,
    make_image,
    make_transforms,
)
from tactile_loc.store.workspace import Workspace

WHOLE = Path(__file__).parent / "whole"
STAGE = StageKey("fuzzed", 1, {"of": "nothing"})
IMAGES = np.random.default_rng(0).integers(0, 256, (3, 6, 8, 3), np.uint8)


def texts(names: str, folder: Path) -> None:
    """Copy TOML files into a folder."""
    for name in names.split():
        shutil.copy(WHOLE / f"{name}.toml", folder)


def listed_poses(folder: Path) -> None:
    """Write three lists of two poses with scores: results of BOP, arrays, and detections of ROS."""
    row = "1,1,1,{},1 0 0 0 1 0 0 0 1,0 0 {},-1\n"
    (folder / "bop.csv").write_text(
        "scene_id,im_id,obj_id,score,R,t,time\n" + row.format(0.6, 25) + row.format(0.4, 30)
    )
    np.savez(folder / "arrays.npz", poses=np.stack([np.eye(4)] * 2), scores=[0.6, 0.4])
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.025}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    found = {"hypothesis": {"class_id": "pin", "score": 0.6}, "pose": {"pose": pose}}
    (folder / "ros.json").write_text(json.dumps({"detections": [{"results": [found, found]}]}))


def mesh(suffix: str, folder: Path, **options: object) -> None:
    """Write a mesh file of a wedge on a plate, in mm, with 24 faces and without symmetry."""
    plate = trimesh.creation.box((30.0, 20.0, 4.0))
    wedge = trimesh.convex.convex_hull([[0, 0, 2], [9, 0, 2], [0, 5, 2], [0, 0, 8], [9, 0, 3], [0, 5, 5]])
    part = trimesh.util.concatenate([plate, wedge])
    part.export(folder / f"part.{suffix.removesuffix('_ascii')}", file_type=suffix, **options)


def polygons(folder: Path) -> None:
    """Write a wedge with quadrilateral faces as PLY."""
    vertices = "0 0 0\n9 0 0\n9 7 0\n0 7 0\n0 0 5\n9 0 5\n"
    faces = "4 3 2 1 0\n4 0 1 5 4\n4 1 2 3 5\n3 3 4 5\n3 0 4 3\n3 1 2 5\n"
    head = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
    more = "element face 6\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / "part.ply").write_text(head + more + vertices + faces)


def encoded_texts(names: str, folder: Path) -> None:
    """Write TOML files with a byte order mark, in UTF-8 and in UTF-16."""
    for name in names.split():
        text = (WHOLE / f"{name}.toml").read_text()
        (folder / f"{name}-8.toml").write_text(text, encoding="utf-8-sig")
        (folder / f"{name}-16.toml").write_text(text, encoding="utf-16")


def sensor(folder: Path) -> None:
    """Write a sensor, its mask and its surface."""
    texts("sensor", folder)
    mask = np.full((40, 48), 255, np.uint8)
    mask[:3] = 0
    Image.fromarray(mask).save(folder / "mask.png")
    np.save(folder / "surface.npy", np.linspace(0, 2e-4, 48, dtype=np.float32) * np.ones((40, 1), np.float32))


def touches(folder: Path) -> None:
    """Write a touch of a sphere in each format, and the sensor of this touch."""
    sensor(folder)
    y, x = np.mgrid[:40, :48]
    depth_m = np.minimum(1e-6 * ((x - 20.0) ** 2 + (y - 18.0) ** 2) * 20, 2e-3).astype(np.float32)
    T, press = np.diag([1.0, -1.0, -1.0, 1.0]), np.array(2e-3)
    more = {"press_depth": press, "indentation": press, "T_sensor_object": T, "T_base_sensor": T}
    np.savez_compressed(folder / "touch.npz", depth=depth_m, unit=np.array("m"), **more)
    np.save(folder / "touch.npy", 1e3 * depth_m)
    Image.fromarray(np.rint(1e6 * depth_m).astype(np.uint16)).save(folder / "touch.png")


def touch_list(folder: Path) -> None:
    """Write a list of touches, and the files that it names."""
    touches(folder)
    texts("touches mount", folder)


def calibration(folder: Path) -> None:
    """Write an untrained calibrated sensor, and images for it: with three colours, a palette, or an alpha channel."""
    write_calibrated(folder / "sensor")
    image = np.array(Image.open(folder / "sensor" / "background.png"))
    image[20:30, 20:30] += 9
    Image.fromarray(image).save(folder / "photo.png")
    Image.fromarray(image).save(folder / "photo.jpg", quality=95)
    np.save(folder / "photo.npy", image)
    Image.fromarray(image).convert("RGBA").save(folder / "photo.tif")
    Image.fromarray(image).quantize().save(folder / "palette.png")


def presses(folder: Path) -> None:
    """Write labelled presses of a ball, and the sensor."""
    ball_set(3, px=32).write(folder)


def weights(folder: Path) -> None:
    """Write the weights of a small encoder."""
    from safetensors.torch import save_file

    from tactile_loc.plugins.encoders.moco.encoder import MocoEncoder

    network = MocoEncoder(MocoEncoder.Options(channels=8))._make_network(0, partly_seen=False)
    save_file(network.state_dict(), folder / "encoder.safetensors")


def make_stage(work: Workspace) -> None:
    """Write a file of each kind into an artifact."""
    work.save_array("mapped", np.arange(30.0))
    work.save_array("packed", np.arange(40), packed=True)
    work.save_json("sizes", [3, 4])


def artifact(folder: Path) -> None:
    """Write a store with one artifact that has each kind of file."""
    StageStore(folder).build(STAGE, make_stage)


def result(folder: Path) -> None:
    """Locate a simulated touch, and write the result and some approaches."""
    sensor(folder)
    settings = {"grid": {"name": "face", "spacing_mm": 8}, "shape_px": 32, "top": 3, "temperature": 0.1}
    settings["sensor"] = {"name": "file", "path": str(folder / "sensor.toml")}
    write_run(folder, Localizer.create("pin", store=StageStore(folder / "store"), **settings))
    for name in ("sensor.toml", "mask.png", "surface.npy"):
        (folder / name).unlink()
    some = (WHOLE / "approaches.toml").read_text(encoding="utf-8").partition("[[approach]]\nxyz")[0]
    (folder / "approaches.toml").write_text(some.replace("T_base_sensor", "T_sensor_next"), encoding="utf-8")


def sweep(folder: Path) -> None:
    """Write the table of a sweep."""
    write_sweep(folder)


def mcap(folder: Path) -> None:
    """Write a recording of images and transforms."""

    def fill(writer: RecordingWriter) -> None:
        writer.write("/tf_static", TF, make_transforms({("flange", "gel"): np.eye(4)}, 0), 0)
        for k, image in enumerate(IMAGES):
            writer.write("/gel/image", IMAGE, make_image(image, "rgb8", k, "gel"), k)

    write_recording(folder / "drive.mcap", fill)


def compressed(folder: Path) -> None:
    """Write a recording of compressed images: with an alpha channel, grey, and as JPEG."""
    message = load_types(CDR).types[COMPRESSED_IMAGE]

    def fill(writer: RecordingWriter) -> None:
        for k, (kind, mode) in enumerate((("png", "RGBA"), ("png", "L"), ("jpeg", "RGB"))):
            file = BytesIO()
            Image.fromarray(IMAGES[k]).convert(mode).save(file, kind)
            data = np.frombuffer(file.getvalue(), np.uint8)
            form = f"rgb8; {kind} compressed bgr8"
            one = message(header=make_header(k, "gel"), format=form, data=data)
            writer.write("/gel/image", COMPRESSED_IMAGE, one, k)

    write_recording(folder / "drive.mcap", fill)


def bag(kind: str, name: str, folder: Path) -> None:
    """Write a ROS 1 bag, or the folder of a ROS 2 bag."""
    from recording_helpers import write_bag

    write_bag(folder / name, IMAGES, kind)


def video(folder: Path) -> None:
    """Write a short film of a touch, as GIF."""
    frames = np.full((12, 24, 32, 3), 90, np.uint8)
    frames[5:8, 8:16, 8:16] = 200
    first, *others = (Image.fromarray(frame) for frame in frames)
    first.save(folder / "film.gif", save_all=True, append_images=others, duration=50)


def public_sets(folder: Path) -> None:
    """Write presses in each public format."""
    for kind, write in PUBLIC_SETS.items():
        write(folder / kind, IMAGES, IMAGES[0])
