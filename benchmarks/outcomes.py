#!/usr/bin/env python3
"""The probabilities of outcomes: draw examples, and fit the model that is shipped.

`draw` presses parts from any direction and locates each example with one, two, three and five touches. Parts are drawn
by ray casting, which the localizer does not use. Sensors, gels and noises alternate. Some examples have a fault: the
touched part differs from its mesh (`scan`), the press is stated wrongly (`press`), or a sensor pose is wrong
(`sensor`). Sensor poses also have errors of stated size (`stated`). With `--solver contact`, ContactMechanics computes
the surface of an elastic gel; otherwise the project's own solver does. Each part's examples are one file in OUT, and
finished parts are skipped.

`fit` draws the examples that are not in a folder yet. It fits boosted trees to all of them, compares these with a
forest, logistic regression and a network on parts that are left out, and writes the shipped model. It needs
scikit-learn, and about an hour on one core. Press and sensor faults are rarer at work than in the examples, so they
have less weight: see FAULTY_WEIGHT. `verdicts.py` judges the model on other parts.

An example is right if the pose error of its first pose is at most the tolerance.
"""

import argparse
import dataclasses
import json
import logging
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from asked import write_head
from determined import DistanceField, find_rival
from elastic_gel import SIZES_PX, add_noise, press_elastic, view_as
from generated_parts import EVERY, drill, make_box, make_cylinder, make_mesh
from manifold3d import Manifold
from numpy.typing import NDArray
from outside import CORRELATION_M, simulate_scan
from verdicts import Row, print_verdicts, read_rows, settle_row

import tactile_loc.data
from tactile_loc.core.geometry.rigid import Poses, make_transform, rotation_about
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.poses.tolerance import Tolerance, measure_shape_distances
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.hypotheses import compute_nats
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.probability.conformal import ELSEWHERE, Ranking
from tactile_loc.locate.probability.evidence import FEATURES, Question, gather_evidence
from tactile_loc.locate.probability.outcome_model import FILE, FIT_FEATURES, VERSION, Trees, share_outcome
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import judge
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore

Float64 = NDArray[np.float64]

COUNTS = (1, 2, 3, 5)  # touches
SENSORS = {**SIZES_PX, "digit": (120, 160)}
GELS = ("rigid", "layer")
LAYER = {"gel": "layer", "gel_thickness_mm": 4.0, "poisson": 0.48}
MISTAKES = {"none": 0.55, "scan": 0.15, "press": 0.08, "sensor": 0.12, "stated": 0.10}  # and their shares
RIGHT = Tolerance(1e-3)
TOLERANCES_M = (3e-4, 5e-4, 2e-3, 3e-3)  # beside RIGHT, one of these is fitted, too
SCAN_M = (5e-5, 1.5e-4)  # root mean square deviation of a part from its mesh
PRESS = (0.6, 1.5)  # factor of a wrong press
FAULTY, FAULTY_WEIGHT = ("press", "sensor"), 0.3  # so that 7 % of the examples have a faulty press or sensor pose
FOLDS = 5  # of the comparison
NUMBERS = [0, 1, 2, 9, 3, 4, 5, 6]  # of the generated parts of each family
QUANTILE = 0.998  # of the share that right poses leave unexplained; beyond it, a fit is poor
SCORES = 2000  # of examples for conformal sets
NEARLY = 0.01  # of the diagonal of a part
# standard errors of sensor poses; per metre, they also turn by 1000 deg
SENSOR_M, STATED_M = (3e-4, 3e-3), (1e-4, 6e-4)


def list_parts(numbers: Sequence[int], folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield the name, the file and the units of generated parts, one of each family for each number."""
    for number in numbers:
        for family in EVERY:
            name = f"{family}-{number:05d}"
            path = folder / f"{name}.stl"
            if not path.exists():
                make_mesh(name).export(path)
            yield name, str(path), "mm"


def list_twins(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield parts with one small feature, without which they would be symmetric, as `list_parts` does."""
    bracket = (
        make_box(60, 20, 4) + make_box(4, 20, 24).translate([28, 0, 0]) + make_box(4, 20, 24).translate([-28, 0, 0])
    )
    wedge = Manifold.cube((3, 30, 3), True).rotate([0, 45, 0])
    shaft = make_cylinder(60, 5) + make_cylinder(20, 7).translate([0, 0, 20])
    cross = make_cylinder(30, 1).rotate([90, 0, 0]).translate([0, 15, 0])
    plate = make_box(40, 30, 6)
    for x, y in ((14, 9), (-14, 9), (14, -9), (-14, -9)):
        plate = drill(plate, 2, (x, y))
    hexagon = Manifold.cylinder(12, 10, 10, 6)
    twins = {
        "twin-bracket": bracket - wedge.translate([30, 0, 24]),
        "twin-shaft-flat": shaft - make_box(20, 20, 8).translate([0, 14.2, 50]),
        "twin-shaft-hole": shaft - cross.translate([0, 0, 8]),
        "twin-plate": drill(plate, 1.2, (6, 11)),
        "twin-nut": drill(hexagon, 4, (0, 0)) - make_box(2, 30, 1).translate([0, 15, 11.5]),
        "twin-block": make_box(30, 20, 15) - wedge.rotate([0, 0, 90]).translate([0, 10, 15]),
        "twin-pin": make_cylinder(40, 4) + make_cylinder(6, 8) - make_box(3, 20, 2).translate([0, 10, 38.5]),
        "twin-rail": make_box(70, 12, 6) + make_box(70, 5, 4).translate([0, 0, 6]) - cross.translate([20, 0, 7]),
    }
    for name, part in twins.items():
        path = folder / f"{name}.stl"
        raw = part.to_mesh()
        trimesh.Trimesh(raw.vert_properties[:, :3], raw.tri_verts).export(path)
        yield name, str(path), "mm"


def draw_touches(source: RobotTouches, scanned: RobotTouches, mistake: str, rng: np.random.Generator) -> list[Touch]:
    """Return the touches of an example with a mistake; `scanned` draws the part that differs from its mesh."""
    source = scanned if mistake == "scan" else source
    if mistake == "stated":
        std_m = rng.uniform(*STATED_M)
        source = dataclasses.replace(source, sensor_std_m=std_m, sensor_std_rad=np.radians(1e3 * std_m))
    touches, _ = source.draw_example(max(COUNTS), rng)
    if mistake == "press":
        factor = float(np.exp(rng.uniform(*np.log(PRESS))))
        touches = [dataclasses.replace(touch, contact_shape=_scale_depths(touch, factor)) for touch in touches]
    if mistake == "sensor":
        std_m, wrong = rng.uniform(*SENSOR_M), rng.random(len(touches)) < 0.3
        wrong[rng.integers(len(touches))] = True
        careless = dataclasses.replace(source, sensor_std_m=std_m, sensor_std_rad=np.radians(1e3 * std_m))
        for number in np.flatnonzero(wrong):
            T = careless.misplace(np.asarray(touches[number].T_base_sensor), *rng.normal(size=(2, 3)))
            touches[number] = dataclasses.replace(touches[number], T_base_sensor=T)
    return touches


def _scale_depths(touch: Touch, factor: float) -> Any:
    shape = touch.contact_shape
    pressed_m = None if shape.indentation_m is None else factor * shape.indentation_m
    depth_m, press_m = shape.depth_m * np.float32(factor), factor * shape.press_depth_m
    return dataclasses.replace(shape, depth_m=depth_m, press_depth_m=press_m, indentation_m=pressed_m)


def describe(localizer: Localizer, touches: Sequence[Touch], found: Localization, rng: np.random.Generator) -> Row:
    """Return what is observed in a result, and what is right, for RIGHT and for another tolerance."""
    truth, poses = np.asarray(touches[0].T_sensor_object), [*found.hypotheses, *found.unlisted]
    T = np.stack([h.T_sensor_object for h in poses])
    errors_m = measure_pose_errors(localizer.object, T, truth)
    tolerances = (RIGHT, Tolerance(float(rng.choice(TOLERANCES_M))))
    views = enumerate(localizer.make_views(found.touches))
    trusted = [view for number, view in views if number not in found.agreement.outliers]
    row: Row = {"errors_m": errors_m, "ious": np.array([h.imprint_iou for h in poses]), "verdict": str(found.verdict)}
    row["right"], row["seconds"] = found.probability_within(), sum(found.seconds.values())
    evidence = [
        gather_evidence(trusted, poses, Question(localizer.object, one, contradictory=found.agreement.contradictory))
        for one in tolerances
    ]
    row["values"] = np.stack([one.values for one in evidence])
    row["fits"], row["near"] = evidence[0].fits, evidence[0].near
    row["outcomes"] = np.array([find_outcome(errors_m, one.distance_m or 0.0) for one in tolerances])
    row["iou_gap"] = float(evidence[0].values[FEATURES.index("iou_gap")])
    return row


def find_outcome(errors_m: Float64, limit_m: float) -> int:
    """Return 0 if the first pose is right, 1 if another one is, and 2 if none is."""
    return 0 if errors_m[0] <= limit_m else 1 if errors_m.min() <= limit_m else 2


def locate_part(part: tuple[str, str, str], sensors: Sequence[str], arguments: argparse.Namespace) -> list[Row]:
    """Return the rows of all examples of a part, with its file and unit, on some sensors."""
    name, path, units = part
    renderer, rows = registry().create("renderer", "zbuffer", {}), []
    end = time.perf_counter() + arguments.seconds
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder))
        for s, sensor in enumerate(sensors):
            for g, gel in enumerate(arguments.gels):
                settings = {"name": sensor, "image_size_px": SENSORS[sensor], **(LAYER if gel == "layer" else {})}
                localizer = Localizer.create(path, units=units or "auto", store=store, sensor=settings)
                rng = np.random.default_rng([zlib.crc32(name.encode()), s, g, arguments.seed])
                source, kind = make_source(localizer, renderer, arguments), find_kind(localizer.object)
                field = DistanceField(localizer.object)
                for number in range(arguments.examples):
                    if time.perf_counter() > end:
                        break
                    noise = arguments.noises[(number + s + g) % len(arguments.noises)]
                    mistake = (
                        str(rng.choice(list(MISTAKES), p=list(MISTAKES.values()))) if arguments.mistakes else "none"
                    )
                    altered = source.object
                    if mistake == "scan":
                        rms_m = rng.uniform(*SCAN_M)
                        altered = dataclasses.replace(
                            altered, mesh=simulate_scan(altered.mesh, rms_m, CORRELATION_M, rng)
                        )
                    noisy = dataclasses.replace(source, noise=NOISE[noise])
                    scanned = dataclasses.replace(noisy, object=altered)
                    about = {"part": name, "kind": kind, "sensor": sensor, "gel": gel, "noise": noise}
                    about["mistake"] = mistake
                    clean = arguments.determined and (gel, noise, mistake) == ("rigid", "none", "none")
                    rows += locate_example(localizer, (noisy, scanned), about, rng, field if clean else None)
    return rows


def make_source(localizer: Localizer, renderer: Any, arguments: argparse.Namespace) -> RobotTouches:
    """Return the source of a localizer's touches."""
    geometry = localizer.scene.geometry
    if arguments.solver == "contact" and geometry.gel.is_elastic:
        return ContactTouches(localizer.object, geometry, renderer)
    return RobotTouches(localizer.object, geometry, renderer)


class ContactTouches(RobotTouches):
    """Touches of an elastic gel whose surface ContactMechanics computes."""

    def draw_touch(self, T: Poses, press_m: float, name: str, rng: np.random.Generator) -> Any:
        """Return the touch of a pressed pose (4, 4), metres, as `RobotTouches.draw_touch`."""
        rigid = RobotTouches(self.object, dataclasses.replace(self.geometry, gel=Gel()), self.renderer)
        touch = rigid.draw_touch(T, press_m, name, rng)
        if not isinstance(touch, Touch):
            return touch
        try:
            shown = view_as(press_elastic(touch, rigid, self.geometry.gel), self.geometry.gel)
            noisy = add_noise(shown, rigid, self.noise, rng)
        except TactileLocError as error:
            return error
        T_base_sensor = self.misplace(np.asarray(touch.T_base_sensor), *rng.normal(size=(2, 3)))
        return dataclasses.replace(noisy, T_base_sensor=T_base_sensor)


def locate_example(
    localizer: Localizer,
    sources: tuple[RobotTouches, RobotTouches],
    about: Row,
    rng: np.random.Generator,
    field: DistanceField | None,
) -> list[Row]:
    """Return a row for each number of touches of an example; a refused one has only its error.

    If a `field` of the object is given, other poses that fit three or five touches are searched for in it.
    """
    try:
        touches = draw_touches(*sources, about["mistake"], rng)
    except TactileLocError:
        return []
    rows = []
    rivals = {} if field is None else find_rivals(sources[0], touches, field)
    for count in COUNTS:
        row = {**about, "touches": count, "rival_m": rivals.get(count)}
        try:
            found = localize_together([(localizer, touch) for touch in touches[:count]])
            rows.append({**row, **describe(localizer, touches[:count], found, rng)})
        except TactileLocError as error:
            rows.append({**row, "error": str(error)})
    return rows


def find_rivals(source: RobotTouches, touches: Sequence[Touch], field: DistanceField) -> dict[int, float]:
    """Return the pose error, metres, of another pose that fits three or five touches; 0 if there is none."""
    three = find_rival(source.object, source.renderer, touches[:3], field)
    return {3: three, 5: find_rival(source.object, source.renderer, touches[:5], field) if three else 0.0}


def find_kind(obj: ObjectModel) -> str:
    """Return "shaft" if an odd turn about a principal axis nearly maps a part onto itself, "twin" if half a turn does.

    All other parts are "other". The surfaces are then apart by at most NEARLY diameters on average.
    """
    middle_m, extent_m = obj.mesh.centroid_m, float(np.linalg.norm(obj.mesh.extents_m))
    axes = np.linalg.svd(obj.mesh.sample(4000, np.random.default_rng(0)) - middle_m, full_matrices=False)[2]
    for kind, degrees in (("shaft", 37.0), ("twin", 180.0)):
        R = np.stack([rotation_about(axis, np.radians(degrees)) for axis in axes])
        turned = make_transform(R, middle_m - R @ middle_m)
        if measure_shape_distances(obj.mesh, turned, np.eye(4)).min() <= NEARLY * extent_m:
            return kind
    return "other"


def make_classifiers() -> dict[str, Any]:
    """Return the forms of the model of outcomes that are compared; the first one is shipped."""
    from sklearn.ensemble import ExtraTreesClassifier, HistGradientBoostingClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.neural_network import MLPClassifier
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    boosted = {"max_iter": 240, "learning_rate": 0.04, "max_leaf_nodes": 8, "min_samples_leaf": 60, "max_features": 0.3}
    network = MLPClassifier((32, 16), alpha=1.0, early_stopping=True, max_iter=300, random_state=0)
    return {
        "gradient-boosted trees": HistGradientBoostingClassifier(**boosted, random_state=0),
        "forest, 80 random trees": ExtraTreesClassifier(80, min_samples_leaf=5, max_features=0.6, random_state=0),
        "logistic regression": make_pipeline(StandardScaler(), LogisticRegression(C=0.02, max_iter=3000)),
        "network, 32 and 16 units": make_pipeline(StandardScaler(), network),
    }


def train(model: Any, values: Float64, outcomes: NDArray[np.int64], weights: Float64) -> Any:
    """Fit a model to rows with weights (R,), and return it."""
    step = f"{model.steps[-1][0]}__" if hasattr(model, "steps") else ""  # of a pipeline
    return model.fit(values, outcomes, **{f"{step}sample_weight": weights})


def predict_left_out(
    make: Any, values: Float64, outcomes: NDArray[np.int64], weights: Float64, parts: Sequence[str]
) -> Float64:
    """Return the probabilities (R, 3) of rows with weights (R,), each predicted by a fit without its part."""
    names = sorted(set(parts))
    fold = np.array([names.index(part) % FOLDS for part in parts])
    p = np.zeros((len(values), 3))
    for k in range(FOLDS):
        trained = train(make(), values[fold != k], outcomes[fold != k], weights[fold != k])
        p[fold == k] = trained.predict_proba(values[fold == k])
    return p


def compute_log_losses(p: Float64, outcomes: NDArray[np.int64]) -> Float64:
    """Return the negative log-likelihoods (R,) of outcomes (R,) given probabilities (R, C)."""
    return np.asarray(-np.log(np.clip(p[np.arange(len(p)), outcomes], 1e-6, 1)))


def export_trees(model: Any) -> Trees:
    """Return the trees of a scikit-learn model of histogram gradient boosting."""
    columns: dict[str, list[Any]] = {name: [] for name in ("feature", "threshold", "left", "right", "value")}
    roots, outputs, count = [], [], 0
    for stage in model._predictors:
        for output, predictor in enumerate(stage):
            nodes = predictor.nodes
            leaf, here = nodes["is_leaf"].astype(bool), count + np.arange(len(nodes))
            columns["feature"].append(np.where(leaf, 0, nodes["feature_idx"]))
            columns["threshold"].append(np.where(leaf, 0.0, nodes["num_threshold"]))
            columns["left"].append(np.where(leaf, here, count + nodes["left"]))
            columns["right"].append(np.where(leaf, here, count + nodes["right"]))
            columns["value"].append(np.where(leaf, nodes["value"], 0.0))
            roots.append(count)
            outputs.append(output)
            count += len(nodes)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    whole = {name: joined[name].astype(np.int32) for name in ("feature", "left", "right")}
    base = np.asarray(model._baseline_prediction, float).ravel()
    return Trees(
        base,
        np.array(roots, np.int32),
        np.array(outputs, np.int32),
        threshold=joined["threshold"],
        value=joined["value"],
        **whole,
    )


def fit_limits(rows: Sequence[Row]) -> Float64:
    """Return the weights of the share of a touch that a right pose leaves unexplained at most, without mistakes."""
    from sklearn.linear_model import QuantileRegressor

    good = [row for row in rows if row["outcomes"][0] == 0 and row["mistake"] in ("none", "scan", "stated")]
    given = np.concatenate([np.column_stack([np.full(len(r["fits"]), r["touches"]), r["fits"][:, 1:]]) for r in good])
    left = np.concatenate([row["fits"][:, 0] for row in good])
    model = QuantileRegressor(quantile=QUANTILE, alpha=1e-6, solver="highs").fit(given, left)
    return np.array([model.intercept_, *model.coef_])


def compute_set_scores(rows: Sequence[Row], p: Float64) -> Float64:
    """Return the scores (R,) of rows for conformal sets, given the probabilities (R, 3) of their outcomes."""
    scores = []
    for row, outcome in zip(rows, p, strict=True):
        weights = np.exp(compute_nats(row["ious"], row["touches"]))
        shares, missed = share_outcome(weights, row["near"], settle_row(row, outcome))
        found = np.flatnonzero(row["errors_m"] <= 1e-3)
        scores.append(Ranking.of(shares, missed).score(int(found[0]) if len(found) else ELSEWHERE))
    return np.array(scores)


def fit(arguments: argparse.Namespace) -> None:
    """Fit, print the comparison, and write the model."""
    rows = read_rows(arguments.folder)
    values = np.concatenate([row["values"] for row in rows])
    outcomes = np.concatenate([row["outcomes"] for row in rows])
    parts, mistakes = ([row[name] for row in rows for _ in row["outcomes"]] for name in ("part", "mistake"))
    weights = np.where(np.isin(mistakes, FAULTY), FAULTY_WEIGHT, 1.0)
    at_one_mm = np.tile([True, False], len(rows))
    print(f"{len(rows)} results of {len(set(parts))} parts; log losses on parts left out, {FOLDS} folds\n")
    print(write_head("form", "all tolerances", "1 mm", "fit, s"))
    left_out = {}
    for name in make_classifiers():
        start = time.perf_counter()
        p = predict_left_out(lambda name=name: make_classifiers()[name], values, outcomes, weights, parts)
        losses = compute_log_losses(p, outcomes)
        every, one = (np.average(losses[some], weights=weights[some]) for some in (slice(None), at_one_mm))
        print(f"| {name} | {every:.3f} | {one:.3f} | {time.perf_counter() - start:.0f} |", flush=True)
        left_out[name] = p[at_one_mm]
    chosen = next(iter(left_out))
    trees = export_trees(train(make_classifiers()[chosen], values, outcomes, weights))
    sound = np.array([row["mistake"] not in FAULTY for row in rows])
    scores = compute_set_scores(list(compress(rows, sound)), left_out[chosen][sound])
    about = {
        "version": VERSION,
        "features": list(FEATURES),
        "fit_features": list(FIT_FEATURES),
        "quantile": QUANTILE,
        "results": len(rows),
        "parts": sorted(set(parts)),
    }
    kept = np.sort(np.random.default_rng(0).choice(scores, min(len(scores), SCORES), replace=False))
    np.savez_compressed(arguments.out, about=json.dumps(about), scores=kept, limits=fit_limits(rows), **vars(trees))
    print(f"\nwritten: {arguments.out} ({arguments.out.stat().st_size / 1e3:.0f} kB)")
    for row, p in zip(rows, left_out[chosen], strict=True):
        outcome = settle_row(row, p)
        row["right"], row["verdict"] = outcome.right, str(judge(outcome))
    print_verdicts(rows)


def main() -> None:
    """Draw or fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tasks = parser.add_subparsers(dest="task", required=True)
    draw = tasks.add_parser("draw")
    draw.add_argument("out", type=Path)
    draw.add_argument("meshes", nargs="*", help="FILE[:UNITS]; default: generated parts")
    draw.add_argument("--numbers", nargs="+", type=int, default=NUMBERS, help="of generated parts of each family")
    draw.add_argument("--sensors", nargs="+", choices=list(SENSORS), default=list(SENSORS))
    draw.add_argument("--twins", action="store_true", help="parts with one small feature, beside the meshes")
    draw.add_argument("--all-sensors", action="store_true", help="each part on all sensors, not on one in turn")
    draw.add_argument("--gels", nargs="+", choices=GELS, default=list(GELS))
    draw.add_argument("--noises", nargs="+", choices=list(NOISE), default=list(NOISE))
    draw.add_argument("--mistakes", action=argparse.BooleanOptionalAction, default=True)
    draw.add_argument("--solver", choices=("own", "contact"), default="own")
    draw.add_argument("--examples", type=int, default=8, help="of each sensor and gel")
    draw.add_argument("--seconds", type=float, default=600, help="after which no further example of a part is drawn")
    draw.add_argument("--seed", type=int, default=7)
    draw.add_argument("--share", nargs=2, type=int, default=(0, 1), help="K N: every N-th part from number K")
    draw.add_argument("--determined", action="store_true", help="search for other poses that fit clean touches, too")
    fitted = tasks.add_parser("fit")
    fitted.add_argument("folder", type=Path)
    fitted.add_argument("--out", type=Path, default=Path(tactile_loc.data.__file__).parent / FILE)
    arguments = parser.parse_args()
    if arguments.task == "fit":
        draw_all(parser.parse_args(["draw", str(arguments.folder)]))
        fit(arguments)
    else:
        draw_all(arguments)


def draw_all(arguments: argparse.Namespace) -> None:
    """Write a file of rows for each part."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    logging.disable(logging.WARNING)
    given = [(Path(mesh.partition(":")[0]).stem, *mesh.partition(":")[::2]) for mesh in arguments.meshes]
    parts = [*given, *(list_twins(arguments.out) if arguments.twins else ())]
    parts = parts or list(list_parts(arguments.numbers, arguments.out))
    first, step = arguments.share
    for number, part in list(enumerate(parts))[first::step]:
        path = arguments.out / f"{part[0]}.json"
        if path.exists():
            continue
        start = time.perf_counter()
        sensors = arguments.sensors if arguments.all_sensors else [arguments.sensors[number % len(arguments.sensors)]]
        rows = locate_part(part, sensors, arguments)
        draft = path.with_suffix(".draft")
        draft.write_text(json.dumps(rows, default=lambda array: array.tolist()))
        draft.replace(path)
        print(f"{part[0]}: {len(rows)} results, {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
