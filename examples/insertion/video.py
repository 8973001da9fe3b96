"""A video of one trial: the scene, what both gels feel, and the verdict."""

import os
from pathlib import Path

import mujoco
import numpy as np
from experiment import Experiment, make_record
from matplotlib import colormaps
from methods import METHODS, Bench
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from robot import Robot
from scene import OPEN_M
from shapes import PARTS
from touching import SIDES
from trials import Trial

from tactile_loc import TactileLocError, Touch

Image8 = NDArray[np.uint8]

METHOD = "verdict"
FRAMES_PER_S = 12
SCENE_PX, GEL_PX = (400, 420), (150, 200)  # width, height
DEEPEST_M = 6e-4  # of the colour scale
HELD_FRAMES = 18  # of the last picture
COLOURS = 96  # of a gif
VERDICT_COLOURS = {"certain": "#1a7f37", "ambiguous": "#b35900"}


class VideoError(TactileLocError):
    """A video cannot be written."""


class Camera:
    """Takes a frame whenever enough simulated time has passed. Robots call it after each tick."""

    def __init__(self, bench: Bench, trial: Trial) -> None:
        self.bench, self.trial = bench, trial
        width, height = SCENE_PX
        try:
            self.renderer = mujoco.Renderer(bench.robot.model, height, width)
        except (ImportError, RuntimeError, AttributeError) as error:
            backend = os.environ.get("MUJOCO_GL", "")
            raise VideoError(
                f"MuJoCo cannot draw with {backend!r}; install libegl1, or libosmesa6 for OSMesa"
            ) from error
        self.frames: list[Image8] = []
        self.rng = np.random.default_rng(0)
        self._due_s = bench.robot.time_s

    def __call__(self, robot: Robot) -> None:
        """Take a frame if one is due."""
        if robot.time_s >= self._due_s:
            self._due_s += 1 / FRAMES_PER_S
            self.take()

    def take(self) -> None:
        """Take a frame now."""
        robot = self.bench.robot
        scene = Image.fromarray(self._draw_scene(robot))
        frame = Image.new("RGB", (SCENE_PX[0] + 2 * (GEL_PX[0] + 10) + 10, SCENE_PX[1]), "white")
        frame.paste(scene, (0, 0))
        touches = {touch.name.split("-")[0]: touch for touch in self._feel(robot)}
        pen, x = ImageDraw.Draw(frame), SCENE_PX[0] + 10
        for side in SIDES:
            frame.paste(draw_gel(touches.get(side)), (x, 34))
            pen.text((x, 12), f"{side} gel", fill="black", font=ImageFont.load_default(15))
            x += GEL_PX[0] + 10
        self._write_state(pen, SCENE_PX[0] + 10, GEL_PX[1] + 48)
        self.frames.append(np.asarray(frame))

    def _feel(self, robot: Robot) -> list[Touch]:
        return self.bench.gels.touch(robot, self.rng) if max(robot.opening_m) < OPEN_M - 2e-3 else []

    def _draw_scene(self, robot: Robot) -> Image8:
        view = mujoco.MjvCamera()
        middle_m = robot.T_world_gripper[:3, 3]
        view.lookat[:] = [0.55 * middle_m[0], 0, 0.6 * middle_m[2]]
        view.distance, view.azimuth, view.elevation = 0.3, 112, -14
        self.renderer.update_scene(robot.data, view)
        return self.renderer.render()

    def _write_state(self, pen: ImageDraw.ImageDraw, x: int, y: int) -> None:
        bench, large, small = self.bench, ImageFont.load_default(20), ImageFont.load_default(14)
        verdict = bench.log[-1].verdict.value if bench.log else "no verdict yet"
        pen.text((x, y), verdict, fill=VERDICT_COLOURS.get(verdict, "black"), font=large)
        within = bench.log[-1].probability_within() if bench.log else None
        lines = [f"within {bench.log[-1].tolerance.describe()}: {within:.0%}" if within is not None else ""]
        lines += [f"grasp {len(bench.placements)}: {bench.placements[-1]}", f"touches: {len(bench.touches)}"]
        lines.append("inserting" if bench.started is not None else "locating")
        lines.append(f"{self.trial.part}, clearance {self.trial.clearance_mm} mm")
        lines.append(f"time {bench.robot.time_s:.1f} s, force {bench.robot.measure_force_n():.0f} N")
        for k, line in enumerate(lines):
            pen.text((x, y + 32 + 20 * k), line, fill="black", font=small)


def draw_gel(touch: Touch | None) -> Image.Image:
    """Return a picture of a gel's indentation; the top of the gel is up."""
    colours = colormaps["viridis"]
    if touch is None:
        return Image.new("RGB", GEL_PX, tuple(int(255 * c) for c in colours(0.0)[:3]))
    pressed_m = touch.press_depth_m - touch.contact_shape.depth_m  # image x points up
    picture = colours(np.clip(np.rot90(pressed_m) / DEEPEST_M, 0, 1))[..., :3]
    return Image.fromarray((255 * picture).astype(np.uint8)).resize(GEL_PX)


def film(experiment: Experiment, trial: Trial, path: Path) -> None:
    """Write a video of a trial. Raises VideoError if MuJoCo cannot draw, or the file's format is unknown."""
    if path.suffix not in (".gif", ".webm"):
        raise VideoError(f"{path} has an unknown format; choose a name that ends with .gif or .webm")
    robot, start = experiment.start(trial)
    robot.restore(start)
    bench = Bench(robot, PARTS[trial.part](), experiment.find_gels(trial.part), np.random.default_rng(trial.seed))
    camera = Camera(bench, trial)
    robot.watch = camera
    begun_s = robot.time_s
    METHODS[METHOD](bench)
    camera.take()
    record = make_record(METHOD, trial, bench, robot.time_s - begun_s, "")
    print(f"{trial.part}, {trial.clearance_mm} mm: {record.outcome}, {len(camera.frames)} frames")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_video(camera.frames + [camera.frames[-1]] * HELD_FRAMES, path)


def write_video(frames: list[Image8], path: Path) -> None:
    """Write frames (H, W, 3) as a gif or a webm file. Raises VideoError if a library for webm is missing."""
    if path.suffix == ".gif":
        first, *others = (Image.fromarray(frame).quantize(COLOURS, dither=Image.Dither.NONE) for frame in frames)
        first.save(path, save_all=True, append_images=others, duration=1000 // FRAMES_PER_S, loop=0, optimize=True)
        return
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise VideoError("a webm file needs imageio-ffmpeg; run pip install imageio-ffmpeg, or write a gif") from error
    height, width = (size - size % 2 for size in frames[0].shape[:2])
    options = {
        "codec": "libvpx-vp9",
        "fps": FRAMES_PER_S,
        "macro_block_size": 2,
        "output_params": ["-crf", "34", "-b:v", "0"],
    }
    writer = imageio_ffmpeg.write_frames(str(path), (width, height), **options)
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame[:height, :width]))
    writer.close()
