#!/usr/bin/env python3
"""How often the page of `tactile-loc app` follows the virtual finger, without a browser.

An update presses the finger on the object, builds the gel's surface, paints the contact shape, and gives both to viser,
as the page does while a visitor drags. The finger is dragged along the object's longest side and back, while it tilts
and presses more and less. Each mesh is that of a demo object; the large one has the same surface, cut into more
triangles. Updates in which the finger misses the object are cheaper, and do not count. The first update is left out of
the median and the 95 % quantile: it loads compiled code, and builds what the renderer keeps for an object.
"""

import argparse
import io
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tactile_loc_app.page.pictures import paint_wide
from tactile_loc_app.page.scene_view import SceneView
from tactile_loc_app.server import require_viser
from tactile_loc_app.session import Session
from tactile_loc_app.shared_localizers import SharedLocalizers
from tactile_loc_app.virtual_finger import Pose

from tactile_loc import ObjectModel, RunConfig, StageStore
from tactile_loc.plugin import Scene
from tactile_loc.plugin.helpers import make_transform, rotation_about

LARGE = 200_000  # triangles, at least
TILT_RAD = np.radians(25.0)  # the finger tilts up to this angle
ROUNDS = 3.0  # times along the object and back
MARGIN = 0.9  # share of the object along which the finger is dragged


@dataclass(frozen=True)
class Row:
    """The seconds of the updates (N,) in contact, those of the first update, and the number of all updates."""

    seconds: NDArray[np.float64]
    first_s: float
    updates: int

    def format(self, *cells: str) -> str:
        """Return a row of the table that begins with `cells`."""
        median, late = 1e3 * np.quantile(self.seconds, [0.5, 0.95])
        measured = [
            f"{100 * len(self.seconds) / self.updates:.0f} %", f"{1e3 * self.first_s:.0f}", f"{median:.1f}",
            f"{late:.1f}", f"{1 / self.seconds.mean():.0f}",
        ]  # fmt: skip
        return f"| {' | '.join([*cells, *measured])} |"


def write_large(name: str, folder: Path) -> Path:
    """Write a demo object as a mesh of at least LARGE triangles with the same surface, and return its path."""
    import trimesh

    from tactile_loc.io.meshes.mesh_files import load_object

    mesh = load_object(name).mesh
    large = trimesh.Trimesh(1e3 * mesh.vertices_m, mesh.faces, process=False)
    while len(large.faces) < LARGE:
        large = large.subdivide()
    path = folder / f"{name}.stl"
    large.export(path)
    return path


def drag(obj: ObjectModel, above: Pose, count: int, deepest_m: float) -> Iterator[tuple[Pose, float]]:
    """Yield `count` poses `T_base_sensor` (4, 4), metres, of a dragged finger, with their presses in metres.

    The finger begins at `above`, but over the middle of the object's bounding box.
    """
    along = int(np.argmax(obj.mesh.extents_m[:2]))
    place_m = above[:3, 3].copy()
    place_m[:2] = 0.5 * (obj.mesh.corners_m.min(axis=0) + obj.mesh.corners_m.max(axis=0))[:2]
    for turn in 2 * np.pi * ROUNDS * np.arange(count) / count:
        by_m = np.zeros(3)
        by_m[along] = 0.5 * MARGIN * obj.mesh.extents_m[along] * np.sin(turn)
        tilted = rotation_about([0.3, 1.0, 0.2], TILT_RAD * np.sin(2.3 * turn))
        yield make_transform(above[:3, :3] @ tilted, place_m + by_m), deepest_m * (0.6 + 0.3 * np.sin(1.7 * turn))


def place_above(obj: ObjectModel, scene: Scene) -> Pose:
    """Return the pose `T_base_sensor` (4, 4), metres, of a finger above the object's middle that looks down on it."""
    down = rotation_about([1, 0, 0], np.pi)
    middle = obj.mesh.corners_m.mean(axis=0)
    top_m = float(obj.mesh.corners_m[:, 2].max())
    return make_transform(down, np.array([middle[0], middle[1], top_m + scene.geometry.surface_m]))


def measure(session: Session, client: object, count: int) -> Row:
    """Return the times of `count` updates of a session's page; `client` stands for the visitor."""
    view, shape = SceneView(client), client.gui.add_image(np.zeros((2, 2, 3), np.uint8))
    above, seconds, touching = place_above(session.object, session.scene), [], []
    for T, depth_m in drag(session.object, above, count + 1, session.scene.geometry.max_depth_m):
        begin_s = time.perf_counter()
        press = session.press(T, depth_m)
        view.show_press(press)
        shape.image = paint_wide(press.shape, press.geometry)
        seconds.append(time.perf_counter() - begin_s)
        touching.append(press.touches)
    return Row(np.array(seconds[1:])[touching[1:]], seconds[0], count)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", nargs="+", default=["hook"], help="demo objects")
    parser.add_argument("--sensors", nargs="+", default=["gelslim", "gelsight-mini"])
    parser.add_argument("--updates", type=int, default=600)
    arguments = parser.parse_args()
    viser = require_viser()
    with redirect_stdout(io.StringIO()):  # viser prints a banner
        server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        localizers = SharedLocalizers(folder, StageStore(folder / "store"))
        print("| object | triangles | sensor | gel | in contact | first, ms | median, ms | 95 %, ms | updates/s |")
        print("|---|---|---|---|---|---|---|---|---|")
        for known in arguments.objects:
            for words, path in ((known, known), (f"{known}, fine", str(write_large(known, folder)))):
                for sensor in arguments.sensors:
                    for gel in ("rigid", "layer"):
                        chosen = {"object": {"path": path, "units": "mm"}, "sensor": {"name": sensor, "gel": gel}}
                        session = Session(localizers, RunConfig.from_dict(chosen))
                        row = measure(session, server, arguments.updates)
                        print(row.format(words, str(len(session.object.mesh.faces)), sensor, gel), flush=True)
    with redirect_stdout(io.StringIO()):  # viser prints a line
        server.stop()


if __name__ == "__main__":
    main()
