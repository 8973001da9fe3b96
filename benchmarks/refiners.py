#!/usr/bin/env python3
"""Errors and times of refiners from the same most probable grid pose, in one run.

For each mesh and noise, one face has a grid of about `--poses` poses, and `--touches` simulated touches are matched by
pixels. Each touch's candidate is the same for all refiners. The refiners are warmed up, and take turns in a different
order for each touch. Errors are ADD over 10 000 surface points, modulo symmetry, in mm. The touches of the "right mode"
have a candidate within 6 mm of the truth. For the last table, each refiner refines the ten most probable poses and
chooses the pose that explains the touch best.

Touches are drawn by the exact renderer `--renderer`. It differs from the grid's renderer, `--model-renderer`, so that
both do not draw edges in the same way. Meshes are given as FILE[:UNITS]; the default is all demo objects.

Refiners from other libraries get the same clouds as ours. As with ours, a result with less contact overlap than the
candidate is rejected. Missing libraries are left out. To install them: pip install small_gicp probreg
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from asked import load_asked, make_parser
from numpy.typing import NDArray
from single_touch import choose_spacing
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, ObjectModel, PosePosterior, RunConfig, StageStore, TactileLocError, Touch
from tactile_loc.core.poses.pose_errors import compute_adds
from tactile_loc.evaluation.metrics import SURFACE_POINTS
from tactile_loc.evaluation.simulated_touches import SimulatedTouches, require_true_pose
from tactile_loc.plugin import Candidate, Poses, Refiner, registry
from tactile_loc.plugin.helpers import Cloud, CloudRefiner, Registration

Transform = NDArray[np.float64]
Record = dict[str, Any]

OURS: dict[str, tuple[str, dict[str, Any]]] = {
    "none": ("none", {}),
    "icp": ("icp", {}),
    "filterreg, 1 iteration": ("filterreg", {"iterations": 1}),
    "filterreg, 10 iterations": ("filterreg", {"iterations": 10}),
    "filterreg": ("filterreg", {}),
    "joint": ("joint", {}),
    "kiss-icp": ("kiss-icp", {}),
    "render": ("render", {}),
}
CHOOSING = ("icp", "filterreg", "joint", "render")  # these also refine the ten most probable poses
REFERENCE = "icp"
LINES = ("reg-1", "chosen of 10", "nearest of 10")
TEN = 10
RIGHT_MODE_MM = 6.0
DISTINCTIVE = 0.1  # largest probability of a distinctive touch's second mode, as a share of its first mode's
TEMPERATURE = 1e-3  # not fitted, because the modes must not depend on the touches for fitting
LEAST_MM = 1e-3  # smaller differences count as equal


class Peer(CloudRefiner):
    """Registers with a function `align` of another library. It maps source and target clouds to T (4, 4), mm."""

    def __init__(self, align: Callable[[Cloud, Cloud], Transform]) -> None:
        super().__init__()
        self.align = align

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return a Registration with the library's result, or with None if the result is not finite."""
        T_mm = self.align(source, target)
        return Registration(T_mm if np.isfinite(T_mm).all() else None)


def open3d_icp() -> Peer:
    """Return open3d's point-to-plane ICP: one pass, pairs up to 1 mm apart, and 30 iterations (the default)."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    method = registration.TransformationEstimationPointToPlane()

    def align(source: Cloud, target: Cloud) -> Transform:
        moving, fixed = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(c.points_mm)) for c in (source, target))
        fixed.normals = o3d.utility.Vector3dVector(target.normals)
        return np.array(registration.registration_icp(moving, fixed, 1.0, np.eye(4), method).transformation)

    return Peer(align)


def small_gicp_gicp() -> Peer:
    """Return small_gicp's GICP with its defaults: 0.25 mm voxels, pairs up to 1 mm, 20 iterations, one thread."""
    import small_gicp

    def align(source: Cloud, target: Cloud) -> Transform:
        return np.array(small_gicp.align(target.points_mm, source.points_mm).T_target_source)

    return Peer(align)


def probreg_filterreg() -> Peer:
    """Return probreg's point-to-point FilterReg: 20 iterations and an estimated variance, as in its examples."""
    from probreg import filterreg

    def align(source: Cloud, target: Cloud) -> Transform:
        found = filterreg.registration_filterreg(source.points_mm, target.points_mm, update_sigma2=True, maxiter=20)
        T_mm = np.eye(4)
        T_mm[:3, :3], T_mm[:3, 3] = found.transformation.rot, found.transformation.t
        return T_mm

    return Peer(align)


PEERS = {"open3d ICP": open3d_icp, "small_gicp GICP": small_gicp_gicp, "probreg FilterReg": probreg_filterreg}


def list_refiners() -> tuple[dict[str, Refiner], dict[str, str]]:
    """Return the available refiners, and the reason for each missing one."""
    makers: dict[str, Callable[[], Refiner]] = {
        label: partial(registry().create, "refiner", name, options) for label, (name, options) in OURS.items()
    }
    makers |= PEERS
    found: dict[str, Refiner] = {}
    missing: dict[str, str] = {}
    for label, make in makers.items():
        try:
            found[label] = make()
        except (ImportError, TactileLocError) as error:
            missing[label] = f"not installed: {error}"
    return found, missing


def is_distinctive(posterior: PosePosterior, spacing_mm: float) -> bool:
    """Return whether a posterior's second mode has less than `DISTINCTIVE` of the first mode's probability."""
    modes = posterior.modes(2e-3 * spacing_mm, 2)
    return len(modes) < 2 or modes[1].probability < DISTINCTIVE * modes[0].probability


class Bench:
    """One object: its localizer, and the compared refiners."""

    def __init__(self, obj: ObjectModel, arguments: argparse.Namespace, compared: dict[str, Refiner]) -> None:
        base = {"sensor": arguments.sensor, "renderer": arguments.model_renderer, "temperature": TEMPERATURE}
        self.spacing_mm = choose_spacing(obj, base, arguments.poses)
        base["grid"] = {"name": "face", "spacing_mm": self.spacing_mm}
        store = StageStore(arguments.store)
        self.localizer = Localizer(RunConfig.from_dict(base), obj, store)
        self.drawer = Localizer(RunConfig.from_dict({**base, "renderer": arguments.renderer}), obj, store)
        self.compared = compared
        self.points_m = obj.mesh.sample(SURFACE_POINTS, np.random.default_rng(0))

    def collect_records(self, noise: str, touches: int, seed: int) -> list[Record]:
        """Return the measurements of each touch with a level of noise."""
        drawn = [SimulatedTouches(noise, seed).draw_touch(self.drawer, number) for number in range(touches)]
        first = self.find_candidates(drawn[0])[1]
        for refiner in self.compared.values():
            refiner.refine_many(drawn[0], first[:2], self.localizer.scene)
            refiner.refine(drawn[0], first[0], self.localizer.scene)
        return [{"noise": noise, **self.measure(number, touch)} for number, touch in enumerate(drawn)]

    def find_candidates(self, touch: Touch) -> tuple[PosePosterior, list[Candidate]]:
        """Return a touch's posterior and its ten most probable grid poses."""
        posterior = self.localizer.posterior(touch)
        poses = posterior.grid.T_sensor_object
        return posterior, [Candidate(poses[i], int(i), float(posterior.log_p[i])) for i in posterior.top(TEN)]

    def measure(self, number: int, touch: Touch) -> Record:
        """Refine a touch's most probable pose with all refiners, and ten poses with some.

        Returns errors in mm, and times in ms.
        """
        posterior, ten = self.find_candidates(touch)
        order = list(self.compared)
        order = order[number % len(order) :] + order[: number % len(order)]
        record: Record = {
            "object": self.localizer.object.name, "touch": number, "errors_mm": {}, "ms": {}, "choices": {},
            "candidate_mm": float(self.measure_errors_mm(ten[0].T_sensor_object[None], touch)[0]),
            "distinctive": is_distinctive(posterior, self.spacing_mm),
        }  # fmt: skip
        for name in order:
            start = time.perf_counter()
            refined = self.compared[name].refine(touch, ten[0], self.localizer.scene)
            record["ms"][name] = (time.perf_counter() - start) * 1e3
            record["errors_mm"][name] = float(self.measure_errors_mm(refined.T_sensor_object[None], touch)[0])
        record["choices"] = {name: self.choose(name, touch, ten) for name in order if name in CHOOSING}
        return record

    def choose(self, name: str, touch: Touch, ten: list[Candidate]) -> dict[str, float]:
        """Refine ten poses, and choose the pose that explains the touch best.

        Returns the errors of `LINES` in mm, and the time in ms.
        """
        start = time.perf_counter()
        refined = self.compared[name].refine_many(touch, ten, self.localizer.scene)
        poses = np.stack([pose.T_sensor_object for pose in refined])
        chosen = int(self.localizer.scene.imprint_ious(poses, touch).argmax())
        seconds = time.perf_counter() - start
        errors = self.measure_errors_mm(poses, touch)
        lines = zip(LINES, (errors[0], errors[chosen], errors.min()), strict=True)
        return {line: float(error) for line, error in lines} | {"ms": seconds * 1e3}

    def measure_errors_mm(self, poses: Poses, touch: Touch) -> NDArray[np.float64]:
        """Return ADD (K,) in mm of poses (K, 4, 4), modulo symmetry."""
        return 1e3 * compute_adds(self.localizer.object, self.points_m, poses, require_true_pose(touch))


def select(records: list[Record], what: str, name: str) -> NDArray[np.float64]:
    """Return a refiner's numbers (T,) from T records, such as its errors or times."""
    return np.array([record[what][name] for record in records])


def keep_right_mode(records: list[Record]) -> list[Record]:
    """Return the records with a candidate within `RIGHT_MODE_MM` of the truth."""
    return [record for record in records if record["candidate_mm"] <= RIGHT_MODE_MM]


def write_cells(records: list[Record], name: str) -> list[str]:
    """Return the median, the 90th percentile, the share of improved touches, and the median time."""
    if not records:
        return ["", "", "", ""]
    errors, before = select(records, "errors_mm", name), np.array([record["candidate_mm"] for record in records])
    better = np.mean(errors < before - LEAST_MM)
    return [
        f"{np.median(errors):.3f}", f"{np.percentile(errors, 90):.2f}", f"{100 * better:.0f} %",
        f"{np.median(select(records, 'ms', name)):.1f}",
    ]  # fmt: skip


def write_table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [f"| {' | '.join(row)} |" for row in [head, *rows]]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def list_objects(records: list[Record]) -> dict[str, list[Record]]:
    """Return the records of each object."""
    names = dict.fromkeys(record["object"] for record in records)
    return {name: [record for record in records if record["object"] == name] for name in names}


def group_by_object(records: list[Record], compared: dict[str, Refiner], missing: dict[str, str]) -> str:
    """Return the table of one object and noise."""
    near = keep_right_mode(records)
    columns = ["median mm", "90th percentile", "improved", "median ms"]
    head = ["refiner", *columns, *(f"{column}, right mode ({len(near)})" for column in columns)]
    rows = [[name, *write_cells(records, name), *write_cells(near, name)] for name in compared]
    return write_table(head, rows + [[name, why, *[""] * 7] for name, why in missing.items()])


def list_medians(records: list[Record], compared: dict[str, Refiner]) -> str:
    """Return a table of medians, with a row for each object and a column for each refiner."""
    rows = [
        [name, str(len(some)), *(f"{np.median(select(some, 'errors_mm', k)):.3f}" for k in compared)]
        for name, some in list_objects(records).items()
    ]
    return write_table(["object", "touches", *compared], rows)


def compare_relative(records: list[Record], name: str) -> float:
    """Return the geometric mean over objects of a refiner's median error, divided by that of `REFERENCE`."""
    logs = [
        np.log(np.maximum([np.median(select(some, "errors_mm", k)) for k in (name, REFERENCE)], LEAST_MM))
        for some in list_objects(records).values()
    ]
    return float(np.exp(np.mean([mine - reference for mine, reference in logs])))


def summarise(records: list[Record], compared: dict[str, Refiner]) -> str:
    """Return a table with a row for each refiner, over all objects."""
    near = keep_right_mode(records)
    head = ["refiner", f"median / {REFERENCE}'s", "improved", "median ms", f"median / {REFERENCE}'s, right mode"]
    head += ["median mm", "90th percentile", "improved"]
    rows = []
    for name in compared:
        whole, part = write_cells(records, name), write_cells(near, name)
        rows.append(
            [
                name,
                f"{compare_relative(records, name):.2f}",
                *whole[2:],
                f"{compare_relative(near, name):.2f}",
                *part[:3],
            ]
        )
    return write_table(head, rows)


def write_choosing(records: list[Record], compared: dict[str, Refiner]) -> str:
    """Return a table of errors after choosing among ten refined poses: medians and means over all objects."""
    rows = []
    for name in CHOOSING:
        for label, some in (("all", records), ("distinctive", [r for r in records if r["distinctive"]])):
            if name not in compared or not some:
                continue
            lines = {k: np.array([r["choices"][name][k] for r in some]) for k in (*LINES, "ms")}
            errors = [f"{np.median(lines[k]):.3f} ({lines[k].mean():.2f})" for k in LINES]
            rows.append([name, f"{label} ({len(some)})", *errors, f"{np.median(lines['ms']):.0f}"])
    return write_table(["refiner", "touches", *(f"{line}, median (mean) mm" for line in LINES), "ms for ten"], rows)


def report(records: list[Record], noise: str, compared: dict[str, Refiner]) -> str:
    """Return the report of a noise over all objects."""
    some = [record for record in records if record["noise"] == noise]
    parts = {
        "medians, mm": list_medians(some, compared),
        "medians in the right mode, mm": list_medians(keep_right_mode(some), compared),
        "all objects": summarise(some, compared), "choosing": write_choosing(some, compared),
    }  # fmt: skip
    return "\n\n".join(f"noise {noise}, {title}:\n\n{text}" for title, text in parts.items())


def run(arguments: argparse.Namespace) -> None:
    """Measure all meshes, and print the tables of each object when it is done."""
    compared, missing = list_refiners()
    records: list[Record] = []
    for mesh in arguments.objects:
        bench = Bench(load_asked(mesh), arguments, compared)
        for noise in arguments.noise.split(","):
            measured = bench.collect_records(noise, arguments.touches, arguments.seed)
            records += measured
            obj = bench.localizer.object
            print(f"\n{obj.name}, symmetry {obj.symmetry}, {bench.localizer.model.size} poses, noise {noise}:\n")
            print(group_by_object(measured, compared, missing), flush=True)
        if arguments.json:
            settings = {name: str(value) for name, value in vars(arguments).items()}
            arguments.json.write_text(json.dumps({"settings": settings, "records": records}, indent=1) + "\n")
    for noise in arguments.noise.split(","):
        print(f"\n{report(records, noise, compared)}")


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--poses", type=int, default=10_000, help="approximate poses of a grid")
    parser.add_argument("--touches", type=int, default=40, help="touches of each noise")
    parser.add_argument("--noise", default="none,strong", help="noise levels of the touches, separated by commas")
    parser.add_argument("--renderer", default="zbuffer", help="renderer of the touches: zbuffer, raycast or heightmap")
    parser.add_argument("--model-renderer", default="heightmap", help="renderer of the grid and of the refiners")
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--store", type=Path, help="keep the grids here; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="also write the errors and times of every touch here")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        arguments.store = arguments.store or Path(folder)
        run(arguments)


if __name__ == "__main__":
    main()
