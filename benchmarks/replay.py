#!/usr/bin/env python3
"""The speed of replaying a recording, and the errors of its poses.

For each object and noise, a slide of 500 images over the object is drawn by ray casting, which the localizer does not
use. It is written as an MCAP recording with TF, and replayed into the base frame. Another library, mcap-ros2-support,
reads the resulting recording, and the messages are compared with the truth.

The table has the number of images, the skipped images without contact and, in parentheses, the images that were located
although the sensor was lifted off, and the refused images. Images per second include reading and writing. Then follow
the time for each image except locating it, the median pose error with the 90 % quantile in parentheses, and the share
within 1 mm, also of the shape distance. For poses within 1 mm, the last column is the median squared error over the
message's covariance (5.35 for a true covariance). Models are built beforehand. Each image is located separately, among
all poses of the object. Therefore an image that looks like another place of the object gives a pose at that place.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from asked import make_parser
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from tactile_loc import Localizer, LocatedFrame, PoseMetric, Recording, Replay, StageStore, Touch
from tactile_loc.core.poses.pose_errors import RIGHT_M, measure_pose_errors
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.metrics import compute_nees
from tactile_loc.evaluation.slides import BASE, IMAGE_TOPIC, T_BASE_OBJECT, Slide, draw_random_slide, write_slide
from tactile_loc.io.streams.ros_messages import read_pose, read_stamp_ns
from tactile_loc.plugin import registry
from tactile_loc.tracking.replay_files import Replayed, ReplayOutput, locate_each_to

POSE_TOPIC = "/object/pose"


def decode(path: Path, topic: str) -> list[Any]:
    """Return the messages of a topic, as read by an independent library."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [found.decoded_message for found in reader.iter_decoded_messages(topics=[topic])]


def replay(localizer: Localizer, source: Path, out: Path) -> tuple[Replayed, float, float]:
    """Replay a recording into the base frame. Return the result, the seconds in all, and the seconds for locating."""
    locating_s = 0.0

    def estimate(touch: Touch) -> LocatedFrame:
        nonlocal locating_s
        begun = time.perf_counter()
        try:
            return LocatedFrame.of(localizer.localize(touch))
        finally:
            locating_s += time.perf_counter() - begun

    start = time.perf_counter()
    recording = Recording(source)
    counts = recording.read_contents().counts
    topic = next(topic for topic in counts if topic.name == IMAGE_TOPIC)
    asked = Replay(recording, topic, localizer, base_frame=BASE, frame_tree=recording.read_frame_tree())
    found = locate_each_to(ReplayOutput(out, POSE_TOPIC), asked, counts[topic], estimate)
    return found, time.perf_counter() - start, locating_s


def measure_errors(
    localizer: Localizer, poses: list[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the pose errors and shape distances (N,), metres, and the normalised squared errors of near poses."""
    metric = PoseMetric(localizer.object)
    T = np.stack([read_pose(message).T for message in poses])
    covariances = np.stack([np.reshape(read_pose(message).covariance, (6, 6)) for message in poses])
    error_m = measure_pose_errors(localizer.object, T, T_BASE_OBJECT)
    near = np.flatnonzero((error_m <= RIGHT_M) & (covariances[:, 0, 0] > 0))
    squared = [compute_nees(metric, T[k], covariances[k], T_BASE_OBJECT) for k in near]
    return error_m, measure_shape_distances(localizer.object.mesh, T, T_BASE_OBJECT), np.array(squared)


def write_row(localizer: Localizer, slide: Slide, level: str, folder: Path) -> str:
    """Return one row of the table."""
    source, out = folder / "slide.mcap", folder / "poses.mcap"
    write_slide(source, slide)
    found, seconds, locating_s = replay(localizer, source, out)
    poses = decode(out, POSE_TOPIC)
    lifted = {int(slide.stamps_ns[number]) for number in slide.frames if slide.press_m[number] <= 0}
    imagined = sum(read_stamp_ns(message.header) in lifted for message in poses)
    error_m, shape_m, squared = measure_errors(localizer, poses)
    summary = found.summary
    return (
        f"| {localizer.object.name} | {level} | {summary.frames} | {summary.no_contact} ({imagined}) | "
        f"{summary.refused} | "
        f"{summary.frames / seconds:.1f} | {1e3 * (seconds - locating_s) / summary.frames:.1f} | "
        f"{1e3 * np.median(error_m):.2f} ({1e3 * np.quantile(error_m, 0.9):.2f}) | "
        f"{(error_m <= RIGHT_M).mean():.0%} | {(shape_m <= RIGHT_M).mean():.0%} | "
        f"{np.median(squared) if len(squared) else np.nan:.1f} |"
    )


def main() -> None:
    """Print the table."""
    parser = make_parser(__doc__, ["hook", "head"])
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--levels", nargs="+", default=["none", "mild"], choices=list(NOISE))
    parser.add_argument("--images", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--store", type=Path)
    arguments = parser.parse_args()
    print(
        "| object | noise | images | no contact (located) | refused | images/s | beside locating, ms | "
        "error, mm (90 %) | within 1 mm | shape within 1 mm | NEES |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    renderer = registry().create("renderer", "zbuffer", {})
    for name in arguments.objects:
        localizer = Localizer.create(name, sensor=arguments.sensor, store=StageStore(arguments.store))
        localizer.localize(localizer.simulate(1)[0])  # builds the model and compiles
        for level in arguments.levels:
            slide = draw_random_slide(localizer, arguments.images, arguments.seed, NOISE[level], renderer)
            with tempfile.TemporaryDirectory() as folder:
                print(write_row(localizer, slide, level, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
