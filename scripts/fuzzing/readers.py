"""Every reader, what it reads, and what of an accepted input must hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fuzzing import corpora

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.io.recordings import Message

PART = ("--object", "pin", "--grid", "face", "-o", "grid.spacing_mm=8")


@dataclass(frozen=True)
class Reader:
    """Something that reads files of a folder, and the command that reads them, without which it has no words.

    `write` makes them as they should be, `read` reads them and checks what was accepted; of them `fuzzed` ones, by
    their patterns, are damaged. `words` are the command line's, FOLDER standing for the folder. `names_file` says
    whether a refusal names the file; components do not know which one asked for them.
    """

    name: str
    write: Callable[[Path], None]
    read: Callable[[Path], object]
    words: tuple[str, ...] = ()
    fuzzed: tuple[str, ...] = ("**/*",)
    names_file: bool = True

    def files(self, folder: Path) -> list[Path]:
        """Return the files that may be damaged, in a fixed order."""
        return sorted({path for pattern in self.fuzzed for path in folder.glob(pattern) if path.is_file()})


def _only(folder: Path, pattern: str = "*") -> Path:
    return next(iter(sorted(folder.glob(pattern))))


def _every(reads: Iterable[Callable[[], object]]) -> None:
    """Read one after another; of what is refused, raise the first when all are read."""
    from tactile_loc.core.errors import TactileLocError

    refusals = []
    for read in reads:
        try:
            read()
        except TactileLocError as error:
            refusals.append(error)
    if refusals:
        raise refusals[0]


def _object(folder: Path) -> None:
    from tactile_loc.io.meshes import load_object

    mesh = load_object(_only(folder, "part.*"), "mm").mesh
    if not (np.isfinite(mesh.vertices_m).all() and 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices_m)):
        raise AssertionError("a surface was accepted that is none")


def _sensor_of(folder: Path):
    from tactile_loc.core.slots.registry import registry

    return registry().create("sensor", "file", {"path": str(folder / "sensor.toml")})


def _touch(name: str, unit: str | None) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from tactile_loc.io.touches import read_touch

        sensor = _sensor_of(folder)
        touch = read_touch(folder / name, sensor, unit)
        depth_m, press_m = touch.contact_shape.depth_m, touch.press_depth_m
        if not (depth_m.shape == sensor.geometry.shape and press_m > 0 and (depth_m >= 0).all()):
            raise AssertionError("a touch was accepted whose depths are none")
        if not (depth_m <= np.float32(press_m)).all():
            raise AssertionError("a touch was accepted that is deeper than its press")
        _require_rigid(touch.T_base_sensor, touch.T_sensor_object)

    return read


def _require_rigid(*poses: np.ndarray | None) -> None:
    from tactile_loc.core.geometry.rigid import is_rigid

    if not all(T is None or (np.isfinite(T).all() and is_rigid(T)) for T in poses):
        raise AssertionError("a pose was accepted that is none")


def _touch_list(folder: Path) -> None:
    from tactile_loc.io.touch_lists import read_touch_list

    for listed in read_touch_list(folder / "touches.toml"):
        _require_rigid(listed.T_base_sensor, listed.T_base_flange)


def _sensor(folder: Path) -> None:
    geometry = _sensor_of(folder).geometry
    if not all(np.isfinite(rays).all() for rays in geometry.pixel_slopes):
        raise AssertionError("a sensor was accepted whose rays are none")


def _priors(folder: Path) -> None:
    _every(partial(_prior, path) for path in sorted(folder.iterdir()))


@cache
def _pin() -> ObjectModel:
    from tactile_loc.io.meshes import load_object

    return load_object("pin")


def _prior(path: Path) -> None:
    from tactile_loc.io.prior_files import read_prior

    prior = read_prior(path, _pin()).seen_from(np.eye(4))
    if np.isnan(prior(np.stack([np.eye(4)] * 3))).any():
        raise AssertionError("a prior was accepted that knows no number")


def _mount(folder: Path) -> None:
    from tactile_loc.io.mount_files import read_mount

    mount = read_mount(folder / "mount.toml")
    _require_rigid(mount.T_flange_sensor)
    if not np.isfinite(mount.std_at(np.array([0, 0, 0.02]))).all():
        raise AssertionError("a mount was accepted whose error is no number")


def _configuration(folder: Path) -> None:
    from tactile_loc.core.slots.registry import registry
    from tactile_loc.io.config import RunConfig

    config = RunConfig.from_toml(folder / "run.toml")
    for slot in ("sensor", "renderer", "grid", "encoder", "matcher", "refiner", "fuser"):
        chosen = getattr(config, slot)
        registry().create(slot, chosen.name, chosen.options)


def _plan(folder: Path) -> None:
    from tactile_loc.sweeps.plan import Plan, name_choices

    name_choices(Plan.from_toml(folder / "plan.toml"))


def _approaches(folder: Path) -> None:
    from tactile_loc.io.approach_files import read_approaches

    _require_rigid(*(one.T_base_sensor for one in read_approaches(folder / "approaches.toml", np.eye(4))))


def _presses(folder: Path) -> None:
    from tactile_loc.calibration.presses import read_presses
    from tactile_loc.io.sensor_files import read_sensor_file

    presses = read_presses(folder, read_sensor_file(folder / "sensor.toml"))
    for number in range(len(presses)):
        if not np.isfinite(presses.label(number).slope[presses.label(number).known]).all():
            raise AssertionError("a label was accepted whose slopes are no numbers")


def _calibration(folder: Path) -> None:
    from tactile_loc.core.slots.registry import registry
    from tactile_loc.io.touches import read_touch

    sensor = registry().create("sensor", "calibrated", {"path": str(folder / "sensor")})
    names = ("photo.png", "photo.jpg", "photo.npy")
    _every(partial(read_touch, folder / name, sensor, "m") for name in names)


def _weights(folder: Path) -> None:
    from tactile_loc.plugins.encoders.moco.encoder import MocoEncoder

    MocoEncoder(MocoEncoder.Options(channels=8)).load_weights(folder / "encoder.safetensors")


def _artifact(folder: Path) -> None:
    """Whatever was damaged, what the store returns is what was built."""
    from tactile_loc.store.store import StageStore

    store = StageStore(folder)
    store.entries()
    found = store.build(corpora.STAGE, corpora.make_stage)
    mapped, packed = found.array("mapped"), found.array("packed")
    same = np.array_equal(mapped, np.arange(30.0)) and np.array_equal(packed, np.arange(40))
    if not (same and found.json("sizes") == [3, 4]):
        raise AssertionError("a damaged artifact was read")


def _report(folder: Path) -> None:
    from tactile_loc.reports import find_source, write_report

    write_report(find_source(folder), folder / "page.html")


def _next_touch(folder: Path) -> None:
    from tactile_loc.io.approach_files import read_approaches
    from tactile_loc.tasks.next_touch import next_touch
    from tactile_loc.tasks.next_touch_files import next_touch_record, read_modes

    modes, T_base_sensor = read_modes(folder / "result.json")
    next_touch_record(next_touch(modes, read_approaches(folder / "approaches.toml", T_base_sensor)[:1]))


def _compared(folder: Path) -> None:
    from tactile_loc.sweeps.comparison import compare, format_texts
    from tactile_loc.sweeps.results import read_sweep

    found = read_sweep(folder)
    format_texts(compare(found, found, "chosen"))


def _recording(folder: Path) -> None:
    """Every image and transform of a recording; of a damaged one those before the damage."""
    from tactile_loc.io.recordings import Recording
    from tactile_loc.io.ros_messages import IMAGE_TYPES

    recording = Recording(_only(folder, "drive*"))
    recording.contents()
    _every(partial(_image, message) for message in recording.messages() if message.topic.type in IMAGE_TYPES)
    list(recording.extras())
    recording.frame_tree()


def _image(message: Message) -> None:
    from tactile_loc.io.ros_messages import image_array, stamp_ns

    image = message.decoded()
    stamp_ns(image.header)
    image_array(image)


def _video(folder: Path) -> None:
    from tactile_loc.calibration.frames import read_frames

    read_frames(folder / "film.gif")


def _public_sets(folder: Path) -> None:
    from tactile_loc.calibration.presses import convert

    sets = (("gs_sdk", "gs_sdk"), ("taxim", "taxim.npz"), ("fots", "fots"), ("circles", "circles"))
    _every(partial(convert, folder / name, folder / "out" / kind, kind, 4.0, 0.1) for kind, name in sets)


def _run(*words: str) -> tuple[str, ...]:
    return ("run", *PART, "--out", "FOLDER/out", "--store", "STORE", *words)


def _mesh(suffix: str, kind: str = "", **options: object) -> Reader:
    words = ("run", "--object", f"FOLDER/part.{suffix}", "--units", "mm", "--grid", "face", "-o", "grid.spacing_mm=15",
             "--out", "FOLDER/out", "--store", "STORE")  # fmt: skip
    return Reader(f"mesh-{kind or suffix}", corpora.mesh(kind or suffix, **options), _object, words)


def _touch_reader(suffix: str, unit: str | None) -> Reader:
    words = _run("--sensor", "FOLDER/sensor.toml", "--touch", f"FOLDER/touch.{suffix}", "--touch-unit", unit or "m")
    name = f"touch.{suffix}"
    return Reader(f"touch-{suffix}", corpora.touches, _touch(name, unit), words, (name,))


def _recorded(name: str, write: Callable[[Path], None], recording: str) -> Reader:
    words = ("replay", f"FOLDER/{recording}", *PART, "--out", "FOLDER/out/x.mcap")
    return Reader(name, write, _recording, words, names_file=False)  # of a message the topic is said


READERS: Sequence[Reader] = (
    _mesh("stl"),
    _mesh("stl", "stl_ascii"),
    _mesh("obj"),
    _mesh("ply"),
    Reader("mesh-ply_ascii", corpora.mesh("ply", encoding="ascii"), _object),
    _mesh("off"),
    _mesh("glb"),
    _mesh("gltf"),
    _touch_reader("npz", None),
    _touch_reader("npy", "mm"),
    _touch_reader("png", "um"),
    Reader("touch-list", corpora.touch_list, _touch_list, _run("--touch", "FOLDER/touches.toml"), ("*.toml",)),
    Reader("sensor", corpora.sensor, _sensor, _run("--sensor", "FOLDER/sensor.toml")),
    Reader("prior", corpora.priors, _priors, _run("--prior", "FOLDER/gaussian.toml")),
    Reader("mount", corpora.texts(mount=corpora.MOUNT), _mount),
    Reader("configuration", corpora.texts(run=corpora.CONFIGURATION), _configuration,
           ("run", "--config", "FOLDER/run.toml", "--out", "FOLDER/out", "--store", "STORE"), ("*",), False),
    Reader("plan", corpora.texts(plan=corpora.PLAN), _plan,
           ("sweep", "FOLDER/plan.toml", "--dry-run", "--out", "FOLDER/out", "--store", "STORE")),
    Reader("approaches", corpora.texts(approaches=corpora.APPROACHES), _approaches),
    Reader("presses", corpora.presses, _presses, ("calibrate", "FOLDER", "--sensor", "FOLDER/sensor.toml", "--out",
           "FOLDER/out", "-o", "steps=5"), ("presses.csv", "sensor.toml", "0000.png", "part.stl")),
    Reader("public-sets", corpora.public_sets, _public_sets),
    Reader("calibration", corpora.calibration, _calibration,
           _run("--sensor", "FOLDER/sensor", "--touch", "FOLDER/photo.png")),
    Reader("weights", corpora.weights, _weights),
    Reader("artifact", corpora.artifact, _artifact, (), ("fuzzed/*/*",)),
    Reader("result", corpora.result, _report, ("report", "FOLDER", "--out", "FOLDER/out/page.html"), ("result.*",)),
    Reader("next-touch", corpora.result, _next_touch, ("next-touch", "FOLDER/result.json", "--candidates",
           "FOLDER/approaches.toml", "--out", "FOLDER/out"), ("result.*", "approaches.toml"), False),
    Reader("evaluation", corpora.evaluation, _report, ("report", "FOLDER", "--out", "FOLDER/out/page.html")),
    Reader("contacts", corpora.contacts, _report, ("report", "FOLDER", "--out", "FOLDER/out/page.html")),
    Reader("sweep", corpora.sweep, _report, ("report", "FOLDER", "--out", "FOLDER/out/page.html")),
    Reader("sweeps-compared", corpora.sweep, _compared, ("sweep", "--compare", "FOLDER", "--out", "FOLDER")),
    _recorded("mcap", corpora.mcap, "drive.mcap"),
    _recorded("bag-ros1", corpora.bag1, "drive.bag"),
    _recorded("bag-ros2", corpora.bag2, "drive"),
    Reader("video", corpora.video, _video, (), ("film.gif",)),
)  # fmt: skip


def reader(name: str) -> Reader:
    """Return the reader of that name."""
    return next(one for one in READERS if one.name == name)
