"""Every reader, its files, and the checks of accepted inputs."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from report_helpers import write_recall

from fuzzing import corpora
from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import TactileLocError, name_source
from tactile_loc.evaluation.sweep.plan import Plan, name_choices
from tactile_loc.io.approach_files import read_approaches
from tactile_loc.io.config import RunConfig
from tactile_loc.io.listed_poses import read_listed_poses
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.io.mount_files import read_mount
from tactile_loc.io.prior_files import read_prior
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.io.streams.recordings import Message, Recording
from tactile_loc.io.streams.ros_messages import IMAGE_TYPES, decode_image, read_stamp_ns
from tactile_loc.io.touch_lists import read_touch_list
from tactile_loc.io.touches import read_touch
from tactile_loc.locate.result.localization import Localization
from tactile_loc.planning.next_touch import choose_next_touch
from tactile_loc.planning.next_touch_files import write_next_touch
from tactile_loc.reports import write_report
from tactile_loc.sensors.calibration.frames import read_frames
from tactile_loc.sensors.calibration.layouts import convert_presses
from tactile_loc.sensors.calibration.presses import read_presses
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore
from tactile_loc.tracking.pose_modes import PoseModes

SLOTS = ("sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser")
SETS = {"gs_sdk": "gs_sdk", "taxim": "taxim/pack.npz", "fots": "fots", "circles": "circles"}
KEPT = "--out FOLDER/out --store STORE"
RUN = f"run --object pin --grid face -o grid.spacing_mm=8 {KEPT}"
REPORT = "report FOLDER --out FOLDER/out/page.html"
NEXT = "next-touch FOLDER/result.json --candidates FOLDER/approaches.toml --out FOLDER/out"


@dataclass(frozen=True)
class Reader:
    """A reader of a folder's files.

    `write` makes correct files. `read` reads the files and checks the outcome. `line` is a command that reads the
    files, if there is one; FOLDER in it stands for the folder. Files that match `fuzzed` are damaged. With
    `names_file`, a refusal must name a file.
    """

    name: str
    write: Callable[[Path], None]
    read: Callable[[Path], object]
    line: str = ""
    fuzzed: tuple[str, ...] = ("**/*",)
    names_file: bool = True

    def files(self, folder: Path) -> list[Path]:
        """Return the files that may be damaged, in a fixed order."""
        return sorted({path for pattern in self.fuzzed for path in folder.glob(pattern) if path.is_file()})


def _read_every(reads: Iterable[Callable[[], object]]) -> None:
    """Call every read function, and then raise the first refusal."""
    refusals = []
    for read in reads:
        try:
            read()
        except TactileLocError as error:
            refusals.append(error)
    if refusals:
        raise refusals[0]


def _object(folder: Path) -> None:
    mesh = load_object(next(iter(sorted(folder.glob("part.*")))), "mm").mesh
    assert np.isfinite(mesh.vertices_m).all(), "a mesh with infinite vertices was accepted"
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices_m), "a mesh with missing vertices was accepted"


def _sensor(folder: Path):
    sensor = registry().create("sensor", "file", {"path": str(folder / "sensor.toml")})
    assert all(np.isfinite(rays).all() for rays in sensor.geometry.pixel_slopes), "a sensor without rays was accepted"
    return sensor


def _touch(name: str, unit: str | None, folder: Path) -> None:
    sensor = _sensor(folder)
    touch = read_touch(folder / name, sensor, unit)
    depth_m, press_m = touch.contact_shape.depth_m, touch.press_depth_m
    assert depth_m.shape == sensor.geometry.shape, "a touch of another size was accepted"
    assert press_m > 0, "a touch without press depth was accepted"
    assert ((depth_m >= 0) & (depth_m <= np.float32(press_m))).all(), "a touch outside its press depth was accepted"
    _require_rigid(touch.T_base_sensor, touch.T_sensor_object)


def _require_rigid(*poses: np.ndarray | None) -> None:
    assert all(T is None or (np.isfinite(T).all() and is_rigid(T)) for T in poses), "an invalid pose was accepted"


@cache
def _pin() -> ObjectModel:
    return load_object("pin")


def _prior(path: Path) -> None:
    prior = read_prior(path, _pin()).view_from(np.eye(4))
    assert not np.isnan(prior(np.stack([np.eye(4)] * 3))).any(), "a prior without a value was accepted"


def _listed(path: Path) -> None:
    listed = read_listed_poses(path)
    _require_rigid(*listed.T_camera_object)
    with name_source(path):  # as `read_prior` does
        for scale in ("equal", "log"):
            assert abs(listed.weigh(scale).sum() - 1) < 1e-6, "scores without probabilities were accepted"


def _mount(folder: Path) -> None:
    mount = read_mount(folder / "mount.toml")
    _require_rigid(mount.T_flange_sensor)
    assert np.isfinite(mount.find_std_at(np.array([0, 0, 0.02]))).all(), "a mount with an infinite error was accepted"


def _configuration(folder: Path) -> None:
    config = RunConfig.from_toml(folder / "run.toml")
    for slot, chosen in ((slot, getattr(config, slot)) for slot in SLOTS):
        registry().create(slot, chosen.name, chosen.options)


def _presses(folder: Path) -> None:
    presses = read_presses(folder, read_sensor_file(folder / "sensor.toml"))
    for label in (presses.label(number) for number in range(len(presses))):
        assert np.isfinite(label.slope[label.known]).all(), "a label with infinite slopes was accepted"


def _calibration(folder: Path) -> None:
    sensor = registry().create("sensor", "calibrated", {"path": str(folder / "sensor")})
    names = ("photo.png", "photo.jpg", "photo.npy", "photo.tif", "palette.png")
    _read_every(partial(read_touch, folder / name, sensor, "m") for name in names)


def _weights(folder: Path) -> None:
    from tactile_loc.plugins.encoders.moco.encoder import MocoEncoder

    MocoEncoder(MocoEncoder.Options(channels=8)).load_weights(folder / "encoder.safetensors")


def _artifact(folder: Path) -> None:
    """Check that the store returns the built artifact after any damage."""
    store = StageStore(folder)
    store.entries()
    found = store.build(corpora.STAGE, corpora.make_stage)
    for name, values in (("mapped", np.arange(30.0)), ("packed", np.arange(40))):
        assert np.array_equal(found.load_array(name), values), "a damaged artifact was read"
    assert found.load_json("sizes") == [3, 4], "a damaged artifact was read"


def _approaches(folder: Path, T_base_sensor: np.ndarray | None):
    return read_approaches(folder / "approaches.toml", T_base_sensor)


def _reported(folder: Path) -> None:
    write_report(folder, folder / "page.html")


def _next_touch(folder: Path) -> None:
    found = Localization.load(folder)
    approaches = _approaches(folder, found.touch.T_base_sensor)[:1]
    write_next_touch(choose_next_touch(PoseModes.of(found), approaches))


def _recording(folder: Path) -> None:
    """Read every image and transform of a recording, up to the damage."""
    recording = Recording(next(iter(sorted(folder.glob("drive*")))))
    recording.read_contents()
    _read_every(partial(_image, message) for message in recording.read_messages() if message.topic.type in IMAGE_TYPES)
    list(recording.read_extras())
    recording.read_frame_tree()


def _image(message: Message) -> None:
    image = message.decode()
    read_stamp_ns(image.header)
    decode_image(image)


def _mesh(kind: str) -> Reader:
    part = f"FOLDER/part.{kind.removesuffix('_ascii')}"
    line = f"run --object {part} --units mm --grid face -o grid.spacing_mm=15 {KEPT}"
    return Reader(f"mesh-{kind}", partial(corpora.mesh, kind), _object, line)


def _touch_reader(suffix: str, unit: str | None) -> Reader:
    line = f"{RUN} --sensor FOLDER/sensor.toml --touch FOLDER/touch.{suffix} --touch-unit {unit or 'm'}"
    name = f"touch.{suffix}"
    return Reader(f"touch-{suffix}", corpora.touches, partial(_touch, name, unit), line, (name,))


def _recorded(name: str, write: Callable[[Path], None], recording: str) -> Reader:
    line = f"replay FOLDER/{recording} --object pin --grid face -o grid.spacing_mm=8 --out FOLDER/out/x.mcap"
    return Reader(name, write, _recording, line, names_file=False)  # a refusal names the topic


_ALL = (
    *map(_mesh, ("stl", "stl_ascii", "obj", "ply")),
    Reader("mesh-ply_ascii", partial(corpora.mesh, "ply", encoding="ascii"), _object),
    Reader("mesh-ply_polygons", corpora.polygons, _object),
    *map(_mesh, ("off", "glb", "gltf")),
    _touch_reader("npz", None),
    _touch_reader("npy", "mm"),
    _touch_reader("png", "um"),
    Reader("touch-list", corpora.touch_list,
           lambda folder: _require_rigid(*(T for one in read_touch_list(folder / "touches.toml")
                                           for T in (one.T_base_sensor, one.T_base_flange))),
           f"{RUN} --touch FOLDER/touches.toml", ("*.toml",)),
    Reader("sensor", corpora.sensor, _sensor, f"{RUN} --sensor FOLDER/sensor.toml"),
    Reader("prior", partial(corpora.texts, "gaussian region half-space"),
           lambda folder: _read_every(partial(_prior, path) for path in sorted(folder.iterdir())),
           f"{RUN} --prior FOLDER/gaussian.toml"),
    Reader("prior-encoded", partial(corpora.encoded_texts, "gaussian region"),
           lambda folder: _read_every(partial(_prior, path) for path in sorted(folder.iterdir()))),
    Reader("listed-poses", corpora.listed_poses,
           lambda folder: _read_every(partial(_listed, path) for path in sorted(folder.iterdir()))),
    Reader("mount", partial(corpora.texts, "mount"), _mount),
    Reader("configuration", partial(corpora.texts, "run"), _configuration, f"run --config FOLDER/run.toml {KEPT}",
           names_file=False),
    Reader("plan", partial(corpora.texts, "plan"),
           lambda folder: name_choices(Plan.from_toml(folder / "plan.toml")),
           f"sweep FOLDER/plan.toml --dry-run {KEPT}"),
    Reader("approaches", partial(corpora.texts, "approaches"),
           lambda folder: _require_rigid(*(one.T_base_sensor for one in _approaches(folder, np.eye(4))))),
    Reader("presses", corpora.presses, _presses,
           "calibrate FOLDER --sensor FOLDER/sensor.toml --out FOLDER/out -o steps=5",
           ("presses.csv", "sensor.toml", "0000.png")),
    Reader("public-sets", corpora.public_sets,
           lambda folder: _read_every(partial(convert_presses, folder / name, folder / "out" / kind, 4.0, 0.1)
                                 for kind, name in SETS.items())),
    Reader("calibration", corpora.calibration, _calibration, f"{RUN} --sensor FOLDER/sensor --touch FOLDER/photo.png"),
    Reader("weights", corpora.weights, _weights),
    Reader("artifact", corpora.artifact, _artifact, "", ("fuzzed/*/*",)),
    Reader("result", corpora.result, _reported, REPORT, ("result.*",)),
    Reader("next-touch", corpora.result, _next_touch, NEXT, ("result.*", "approaches.toml"), False),
    Reader("evaluation", write_recall, _reported, REPORT),
    Reader("sweep", corpora.sweep, _reported, REPORT),
    _recorded("mcap", corpora.mcap, "drive.mcap"),
    _recorded("mcap-compressed", corpora.compressed, "drive.mcap"),
    _recorded("bag-ros1", partial(corpora.bag, "ros1", "drive.bag"), "drive.bag"),
    _recorded("bag-ros2", partial(corpora.bag, "sqlite", "drive"), "drive"),
    Reader("video", corpora.video, lambda folder: read_frames(folder / "film.gif"), "", ("film.gif",)),
)  # fmt: skip
READERS = {one.name: one for one in _ALL}
