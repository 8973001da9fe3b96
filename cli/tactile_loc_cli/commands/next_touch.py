"""`tactile-loc next-touch`: choose the next touch with the largest information gain."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from tactile_loc.core.runtime.errors import ConfigError, ResultError
from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say_written
from tactile_loc_cli.options import declare

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from tactile_loc.core.objects.mesh import TriangleMesh
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
    from tactile_loc.io.approach_files import Approach
    from tactile_loc.io.meshes.mesh_files import Units
    from tactile_loc.planning.clearance import Clearance
    from tactile_loc.tracking.pose_modes import PoseModes

DEFAULT_OUT = Path("tactile-loc-next-touch")
BOX = re.compile(r"(\d*\.?\d+)x(\d*\.?\d+)x(\d*\.?\d+)mm")
DRAWN, MOST = "approaches.toml", 10_000  # file of the drawn approaches, and their largest number
SEED = 0

Result = Annotated[Path, typer.Argument(metavar="RESULT", help="Folder written by run, or its result.json.")]
Seed = Annotated[int, declare("--seed N", "Seed of the approaches of --around.", min=0)]
Top = Annotated[int, declare("--top N", "Number of approaches to show; the file has all of them.")]
Out = Annotated[Path, declare("--out FOLDER", "Folder of next_touch.json, next_touch.png and approaches.toml.")]


@dataclass(frozen=True)
class WantedApproaches:
    """The options that give the approaches: their file, or the number to draw."""

    candidates: Annotated[
        Path | None,
        declare(
            "--candidates FILE.toml",
            "Approaches: [[approach]] tables, each with a start pose: xyz_mm with rpy_deg, or T_sensor_next in metres "
            "(docs/next-touch.md).",
        ),
    ] = None
    around: Annotated[
        int | None,
        declare(
            "--around N",
            "Without --candidates: N approaches from random directions around the object. They are also written to "
            "approaches.toml, which --candidates reads.",
            min=1,
            max=MOST,
        ),
    ] = None

    def find(
        self,
        modes: PoseModes,
        T_base_sensor: NDArray[np.float64] | None,
        finger: TriangleMesh | None = None,
        seed: int = SEED,
    ) -> Sequence[Approach]:
        """Read the candidates, or draw approaches to the modes. Raises ConfigError unless exactly one is asked for."""
        import numpy as np

        from tactile_loc.io.approach_files import read_approaches
        from tactile_loc.planning.approaches import draw_approaches_to_modes

        if self.candidates is not None and self.around is None:
            return read_approaches(self.candidates, T_base_sensor)
        if self.candidates is None and self.around is not None:
            return draw_approaches_to_modes(modes, self.around, np.random.default_rng(seed), finger)
        raise ConfigError("approaches come from one source; give either --candidates FILE.toml or --around N")


@dataclass(frozen=True)
class Obstacles:
    """The options that state what must not be hit."""

    finger: Annotated[
        str | None,
        declare(
            "--finger FILE|XxYxZmm",
            "Body that carries the sensor: a mesh file in the sensor frame, or the sides of a box behind the gel, such "
            "as 32x28x24mm. Approaches are out of reach if it would hit the object. It needs tactile-loc[clearance].",
        ),
    ] = None
    fixture: Annotated[
        Path | None, declare("--fixture FILE", "Mesh file in the base frame that the --finger must not hit either.")
    ] = None
    floor: Annotated[float | None, declare("--floor MM", "The --finger must stay above z = MM of the base frame.")] = (
        None
    )
    units: Annotated[
        options.Units, declare("--units", "Unit of the files of --finger and --fixture. auto: guessed from their size.")
    ] = options.Units.AUTO

    def find_clearance(self, geometry: SensorGeometry, in_base: bool) -> Clearance | None:
        """Read what must not be hit. Raises ConfigError for a fixture or floor without a finger or a base frame."""
        from tactile_loc.io.meshes.mesh_files import load_object
        from tactile_loc.planning.clearance import Clearance, make_box_finger

        is_placed, units = self.fixture is not None or self.floor is not None, cast("Units", self.units.value)
        if self.finger is None:
            if is_placed:
                raise ConfigError("--fixture and --floor need the body that must not hit them; give it as --finger")
            return None
        if is_placed and not in_base:
            raise ConfigError(
                "--fixture and --floor are in the base frame, but the touch has no T_base_sensor; locate it again from "
                "a list of touches with T_base_sensor"
            )
        if box := BOX.fullmatch(self.finger):
            sides_m = [1e-3 * float(side) for side in box.groups()]
            if not min(sides_m) > 0:
                raise ConfigError(f"the box {self.finger} of --finger has a side of 0 mm; give three positive sides")
            body = make_box_finger(sides_m, geometry)
        else:
            body = load_object(self.finger, units, "none").mesh
        held = None if self.fixture is None else load_object(self.fixture, units, "none").mesh
        return Clearance(body, held, None if self.floor is None else 1e-3 * self.floor)


def next_touch(
    result: Result,
    *,
    wanted: WantedApproaches,
    obstacles: Obstacles,
    seed: Seed = SEED,
    top: Top = 10,
    out: Out = DEFAULT_OUT,
) -> dict[str, Any]:
    """Choose where to touch next.

    The next touch should distinguish the poses that a result lists. For each pose and approach, the command simulates
    the sensor's travel until contact and the contact shape. Approaches are ranked by their expected information per
    cost. The output also names the poses that no approach distinguishes, and says when to stop.
    """
    from tactile_loc.io.approach_files import write_approaches
    from tactile_loc.locate.result.localization import Localization
    from tactile_loc.planning.next_touch import choose_next_touch as choose
    from tactile_loc.planning.next_touch_files import write_next_touch
    from tactile_loc.store.files import write_json
    from tactile_loc.tracking.pose_modes import PoseModes
    from tactile_loc.view.pictures import save_figure
    from tactile_loc.view.tasks import draw_next_touch
    from tactile_loc_cli.results import say_next_touch

    located = Localization.load(_find_result(result))
    modes, T_base_sensor = PoseModes.of(located), located.touch.T_base_sensor
    in_base = T_base_sensor is not None
    clearance = obstacles.find_clearance(modes.geometry, in_base)
    approaches = wanted.find(modes, T_base_sensor, None if clearance is None else clearance.finger, seed)
    require_writable(out)
    found = choose(modes, approaches, clearance=clearance)
    document = write_next_touch(found)
    say_next_touch(found, top)
    poses, rated = format_count(len(modes.probabilities), "possible pose"), format_count(len(found.ranked), "approach")
    title = f"{modes.object_names}: {poses}, {rated}"
    written = [
        write_json(out / "next_touch.json", document),
        save_figure(out / "next_touch.png", draw_next_touch(found, title)),
    ]
    if wanted.around is not None:
        written.append(write_approaches(out / DRAWN, approaches, in_base))
    return {**document, "written": say_written(written)}


def _find_result(path: Path) -> Path:
    """Return the result.json of a folder, or the path itself if it is not a folder. Raises ResultError without one."""
    from tactile_loc.reports import find_result

    if not path.is_dir():
        return path
    document = find_result(path)
    if document.stem != "result":
        raise ResultError(f"{path} is the folder of another command; give the folder that run wrote")
    return document
