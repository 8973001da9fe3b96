"""The mistakes that `mistakes` makes: changes of what a user gives, with the expected outcome and the cause of each.

The expected outcomes were written down before the first run. A cause is what a message should name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter, zoom
from scipy.spatial.transform import Rotation

from tactile_loc import GaussianPrior, TriangleMesh, simplify_mesh
from tactile_loc.plugin.helpers import draw_rotations, invert, make_transform, make_translation, rotation_about

Array = NDArray[Any]
Settings = dict[str, Any]

REFUSED, DOUBTED, CERTAIN = ("refused",), ("doubted",), ("certain",)
SAFE = (*REFUSED, *DOUBTED)
ANY = (*SAFE, *CERTAIN)
RIGHT = (*SAFE, "right")  # the mistake leaves a certain answer right

SENSOR: Settings = {"name": "gelsight-mini", "image_size_px": (160, 120)}
LAYER: Settings = {**SENSOR, "gel": "layer"}
UNITS, PRESS, POSES, IMAGES, SENSORS, PART, PRIORS = "unit", "press", "sensor pose", "image", "sensor", "part", "prior"
# What a message that names a cause says
WORDS = {
    UNITS: r"\bunits?\b|in metres|\bscale",
    PRESS: r"\bpress",
    POSES: r"T_base_sensor|sensor poses|moved",
    IMAGES: r"mirror|image|opposite|kind=|\bmaps?\b|\bsign\b",
    SENSORS: r"(?<!on the )\bsensors?\b(?! poses)",
    PART: r"\bobject\b(?! moved| on)|\bmesh|\bpart\b",
    PRIORS: r"\bprior",
}


@dataclass(frozen=True, eq=False)
class Given:
    """What a user gives: maps of distances (H, W), metres, sensor poses (4, 4), metres, a mesh, a sensor and a prior.

    `press_m` are the true presses. `read` are arguments of `Touch.from_depth`, or of `Touch.from_mask` if they have no
    `kind`. Its `press` is the stated press as a multiple of the true one. `pitch` multiplies the size of the sensor's
    pixels. `truth` (4, 4), metres, is the object's true pose in the base frame, and `other` are another object and a
    map of it. `rng` draws what a mistake needs.
    """

    maps: tuple[Array, ...]
    poses: tuple[Array, ...]
    press_m: tuple[float, ...]
    truth: Array
    mesh: TriangleMesh
    other: tuple[TriangleMesh, Array]
    rng: np.random.Generator
    sensor: Settings = field(default_factory=lambda: SENSOR)
    pitch: float = 1.0
    read: Settings = field(default_factory=lambda: {"kind": "distance"})
    prior: GaussianPrior | None = None

    def indent(self) -> Given:
        """Give indentations (H, W), metres, instead of distances."""
        pairs = zip(self.press_m, self.maps, strict=True)
        indented = tuple(np.where(one < m * (1 - 1e-6), m - one, 0.0) for m, one in pairs)
        return replace(self, maps=indented, read={"kind": "indentation"})


Change = Callable[[Given], Given]


@dataclass(frozen=True)
class Mistake:
    """A mistake, its expected outcomes, and the causes of which a message should name one.

    `lost` states that no pose is right, because the touches are not those of the object. `reason` states why the data
    may not show the mistake. The touches were taken with the sensor `took`.
    """

    name: str
    make: Change
    expected: tuple[str, ...]
    causes: tuple[str, ...]
    lost: bool = False
    reason: str = ""
    took: Settings = field(default_factory=lambda: SENSOR)


def read(**arguments: Any) -> Change:
    """Return the change that reads the maps with other arguments."""
    return lambda given: replace(given, read={**given.read, **arguments})


def maps(change: Callable[[Array], Array], indentations: bool = False, **arguments: Any) -> Change:
    """Return the change of each map, of distances or of indentations, and of the arguments that read it."""

    def make(given: Given) -> Given:
        given = given.indent() if indentations else given
        changed = tuple(change(one.astype(float)) for one in given.maps)
        return replace(given, maps=changed, read={**given.read, **arguments})

    return make


def order_maps(order: Callable[[int], Sequence[int]]) -> Change:
    """Return the change that gives the maps in another order, or some of them again."""
    return lambda given: replace(given, maps=tuple(given.maps[k] for k in order(len(given.maps))))


def order_poses(order: Callable[[int], Sequence[int]]) -> Change:
    """Return the change that gives the sensor poses in another order, or some of them again."""
    return lambda given: replace(given, poses=tuple(given.poses[k] for k in order(len(given.poses))))


def poses(change: Callable[[Array, int], Array]) -> Change:
    """Return the change of each sensor pose (4, 4), metres, given its number."""
    return lambda given: replace(given, poses=tuple(change(T, number) for number, T in enumerate(given.poses)))


def rotations(change: Callable[[Array], Array]) -> Change:
    """Return the change of the rotation (3, 3) of each sensor pose."""
    return poses(lambda T, number: make_transform(change(T[:3, :3]), T[:3, 3]))


def positions(factor: float) -> Change:
    """Return the change of the unit of the sensor positions."""
    return poses(lambda T, number: make_transform(T[:3, :3], factor * T[:3, 3]))


def mounted(T_flange_sensor: Array) -> Change:
    """Return the change that gives the pose of something that is fixed to the sensor."""
    return poses(lambda T, number: T @ T_flange_sensor)


def moved(shift_m: float, turn_deg: float = 0.0) -> Change:
    """Return the change that moves the object along and about its x axis before each further touch."""

    def make(given: Given) -> Given:
        def move(T: Array, number: int) -> Array:
            turn = rotation_about([1, 0, 0], np.radians(number * turn_deg))
            return given.truth @ make_transform(turn, [number * shift_m, 0, 0]) @ invert(given.truth) @ T

        return poses(move)(given)

    return make


def mesh(change: Callable[[TriangleMesh], TriangleMesh]) -> Change:
    """Return the change of the mesh."""
    return lambda given: replace(given, mesh=change(given.mesh))


def scaled(*factors: float) -> Change:
    """Return the change of the mesh's size, along each axis."""
    return mesh(lambda one: TriangleMesh(one.vertices_m * factors, one.faces))


def revise(one: TriangleMesh) -> TriangleMesh:
    """Return a mesh whose upper third, along its longest axis, is moved sideways by 2 mm."""
    vertices_m, axis = one.vertices_m.copy(), int(one.extents_m.argmax())
    along = vertices_m[:, axis]
    vertices_m[along > along.min() + 0.66 * np.ptp(along), (axis + 1) % 3] += 2e-3
    return TriangleMesh(vertices_m, one.faces)


def fill(one: TriangleMesh) -> TriangleMesh:
    """Return the convex hull of a mesh."""
    hull = trimesh.Trimesh(one.vertices_m, one.faces, process=False).convex_hull
    return TriangleMesh(np.array(hull.vertices), np.array(hull.faces))


def open_up(one: TriangleMesh) -> TriangleMesh:
    """Return a mesh without the tenth of its triangles that is farthest along z."""
    heights = one.vertices_m[one.faces].mean(axis=1)[:, 2]
    return TriangleMesh(one.vertices_m, one.faces[heights < np.quantile(heights, 0.9)])


def sensor(**settings: Any) -> Change:
    """Return the change of the sensor's settings."""
    return lambda given: replace(given, sensor={**given.sensor, **settings})


def expect(change: Callable[[Given, Array], Array], std_m: float = 5e-3, std_rad: float = 0.2) -> Change:
    """Return the change that gives a prior about a pose (4, 4), metres, in the first sensor's frame."""

    def make(given: Given) -> Given:
        T = change(given, invert(given.poses[0]) @ given.truth)
        return replace(given, prior=GaussianPrior(T, std_m, std_rad))

    return make


def shift(size_m: float) -> Callable[[Given, Array], Array]:
    """Return the change of a pose by a shift in a random direction."""

    def make(given: Given, T: Array) -> Array:
        direction = given.rng.normal(size=3)
        return make_translation(size_m * direction / np.linalg.norm(direction)) @ T

    return make


def turn_as_degrees(given: Given, T: Array) -> Array:
    """Return a pose whose rotation vector, in radians, was read as degrees."""
    turn = Rotation.from_rotvec(np.radians(Rotation.from_matrix(T[:3, :3]).as_rotvec())).as_matrix()
    return make_transform(turn, T[:3, 3])


def turn_at_random(given: Given, T: Array) -> Array:
    """Return a pose at the same place with a random rotation."""
    return make_transform(draw_rotations(1, given.rng)[0], T[:3, 3])


def masks(change: Callable[[Array], Array], press: float = 1.0) -> Change:
    """Return the change that gives contact masks, with a multiple of the true press."""

    return lambda given: replace(
        given, maps=tuple(change(one > 0) for one in given.indent().maps), read={"press": press}
    )


def touch_other(given: Given) -> Given:
    """Give the last touch of another object."""
    return replace(given, maps=(*given.maps[:-1], given.other[1]))


def take_other(given: Given) -> Given:
    """Give the mesh of another object."""
    return replace(given, mesh=given.other[0])


def keep_first(change: Change) -> Change:
    """Return the change of which only the first touch is given."""

    def make(given: Given) -> Given:
        changed = change(given)
        return replace(changed, maps=changed.maps[:1], poses=changed.poses[:1])

    return make


def crop(one: Array) -> Array:
    """Return the middle of a map, 80 % of each side, enlarged to the full size."""
    h, w = one.shape
    inner = one[h // 10 : h - h // 10, w // 10 : w - w // 10]
    return zoom(inner, (h / inner.shape[0], w / inner.shape[1]), order=1)


def tilt(one: Array) -> Array:
    """Return indentations plus a plane that rises by 0.2 mm from left to right."""
    return one + np.linspace(0, 2e-4, one.shape[1])


def blank(one: Array) -> Array:
    """Return indentations without a band of a twelfth of the columns, through the contact's middle."""
    columns, middle = one.shape[1], int(np.flatnonzero(one.max(axis=0) > 0).mean())
    changed = one.copy()
    changed[:, max(0, middle - columns // 24) : middle + columns // 24] = 0
    return changed


def roll_quaternion(R: Array) -> Array:
    """Return a rotation (3, 3) whose quaternion was given as w, x, y, z and read as x, y, z, w."""
    return Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), 1)).as_matrix()


def swap_euler(R: Array) -> Array:
    """Return a rotation (3, 3) whose Euler angles about x, y, z were applied in the opposite order."""
    return Rotation.from_euler("zyx", Rotation.from_matrix(R).as_euler("xyz")[::-1]).as_matrix()


def make_unitless(R: Array) -> Array:
    """Return a rotation (3, 3) whose angle, in radians, was read as degrees."""
    return Rotation.from_rotvec(np.radians(Rotation.from_matrix(R).as_rotvec())).as_matrix()


MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
X, Z = [1, 0, 0], [0, 0, 1]
EDGES = "an edge or a corner and its mirror image look alike"
MISSED = "the touches may miss the difference"
SMALL = "the change is near the tolerance"

# fmt: off
MISTAKES = (
    # units
    Mistake("depths in mm as m", maps(lambda one: 1e3 * one), REFUSED, (UNITS,)),
    Mistake("depths in m as mm", read(unit="mm"), REFUSED, (UNITS,)),
    Mistake("grey values as mm", maps(lambda one: 255 * one / one.max(), True, unit="mm"), REFUSED, (UNITS,)),
    Mistake("sensor positions in mm as m", positions(1e3), REFUSED, (UNITS, POSES)),
    Mistake("sensor positions in cm as m", positions(1e2), REFUSED, (UNITS, POSES)),
    Mistake("sensor positions in m as mm", positions(1e-3), SAFE, (UNITS, POSES)),
    Mistake("sensor rotations in radians as degrees", rotations(make_unitless), SAFE, (UNITS, POSES)),
    Mistake("mesh in inches as mm", scaled(1 / 25.4, 1 / 25.4, 1 / 25.4), SAFE, (UNITS, PART)),
    Mistake("mesh in cm as mm", scaled(0.1, 0.1, 0.1), SAFE, (UNITS, PART)),
    Mistake("mesh in mm as inches", scaled(25.4, 25.4, 25.4), SAFE, (UNITS, PART)),
    # conventions of poses
    Mistake("inverted sensor poses", poses(lambda T, number: invert(T)), SAFE, (POSES,)),
    Mistake("transposed rotations", rotations(lambda R: R.T), SAFE, (POSES,)),
    Mistake("quaternions wxyz as xyzw", rotations(roll_quaternion), SAFE, (POSES,)),
    Mistake("Euler angles in the opposite order", rotations(swap_euler), SAFE, (POSES,)),
    Mistake("left-handed base", poses(lambda T, number: MIRROR @ T @ MIRROR), SAFE, (POSES, IMAGES)),
    Mistake("flange instead of sensor", mounted(make_transform(rotation_about(X, 0.4), [0, 0, -0.06])), SAFE, (POSES,)),
    Mistake("z into the gel", mounted(make_transform(rotation_about(X, np.pi), np.zeros(3))), SAFE, (POSES,)),
    Mistake("sensor axes x and y swapped", mounted(make_transform(rotation_about(Z, np.pi / 2), np.zeros(3))), SAFE,
            (POSES, IMAGES)),
    Mistake("origin at the gel", mounted(make_translation([0, 0, 10e-3])), SAFE, (POSES,)),
    Mistake("hand-eye calibration off by 3 mm", mounted(make_translation([3e-3, 0, 0])), SAFE, (POSES,)),
    # images
    Mistake("mirrored images", maps(lambda one: one[:, ::-1]), SAFE, (IMAGES,), lost=True),
    Mistake("one mirrored image alone", keep_first(maps(lambda one: one[:, ::-1])), ANY, (IMAGES,), True, EDGES),
    Mistake("images turned by half", maps(lambda one: one[::-1, ::-1]), SAFE, (IMAGES, POSES), lost=True),
    Mistake("images turned by a quarter", maps(lambda one: one.T), REFUSED, (IMAGES, SENSORS)),
    Mistake("cropped images", maps(crop), SAFE, (IMAGES, SENSORS, UNITS), lost=True),
    Mistake("half resolution", maps(lambda one: one[::2, ::2]), REFUSED, (IMAGES, SENSORS)),
    Mistake("image of the touch before", order_maps(lambda n: [n - 1, *range(n - 1)]), SAFE, (POSES, IMAGES), True),
    Mistake("first image for all touches", order_maps(lambda n: [0] * n), SAFE, (POSES, IMAGES)),
    Mistake("background not subtracted", maps(lambda one: one + 2e-4, True), SAFE, (IMAGES, PRESS)),
    Mistake("tilted background", maps(tilt, True), SAFE, (IMAGES, PRESS)),
    Mistake("opposite sign", maps(lambda one: one, True, kind="distance"), REFUSED, (IMAGES,)),
    Mistake("distances as heights", read(kind="height"), REFUSED, (IMAGES,)),
    Mistake("saturated at half the press", maps(lambda one: np.minimum(one, one.max() / 2), True), SAFE,
            (PRESS, SENSORS)),
    Mistake("depths x 0.5", maps(lambda one: 0.5 * one, True), SAFE, (PRESS, UNITS)),
    Mistake("depths x 1.5", maps(lambda one: 1.5 * one, True), SAFE, (PRESS, UNITS)),
    Mistake("missing columns", maps(blank, True), ("refused", "doubted", "right"), (IMAGES,)),
    Mistake("blurred images", maps(lambda one: gaussian_filter(one, 6), True), SAFE, (IMAGES, SENSORS)),
    Mistake("untouched gel", maps(np.zeros_like, True), REFUSED, (IMAGES, PRESS)),
    # touches
    Mistake("object moved 1 mm a touch", moved(1e-3), RIGHT, (POSES,), reason=SMALL),
    Mistake("object moved 3 mm a touch", moved(3e-3), SAFE, (POSES,)),
    Mistake("object moved 5 mm a touch", moved(5e-3), SAFE, (POSES,)),
    Mistake("object turned 5 degrees a touch", moved(0.0, 5.0), SAFE, (POSES,)),
    Mistake("sensor poses late by one touch", order_poses(lambda n: [n - 1, *range(n - 1)]), SAFE, (POSES,)),
    Mistake("two sensor poses swapped", order_poses(lambda n: [1, 0, *range(2, n)]), SAFE, (POSES,)),
    Mistake("one sensor pose for two touches", order_poses(lambda n: [0, 0, *range(2, n)]), SAFE, (POSES,)),
    Mistake("a touch of another part", touch_other, RIGHT, (PART, POSES)),
    # sensor
    Mistake("another sensor", lambda given: replace(given, sensor={"name": "digit"}), REFUSED, (SENSORS,)),
    Mistake("another image size", sensor(image_size_px=(320, 240)), REFUSED, (SENSORS, IMAGES)),
    Mistake("pixels 10 % too large", lambda given: replace(given, pitch=1.1), SAFE, (SENSORS, UNITS, PART)),
    Mistake("elastic gel read as rigid", sensor(), SAFE, (SENSORS,), took=LAYER),
    Mistake("rigid gel read as elastic", sensor(**LAYER), SAFE, (SENSORS,)),
    Mistake("half the gel's thickness", sensor(**LAYER, gel_thickness_mm=2.0), RIGHT, (SENSORS,),
            reason="near the contact, both gels look alike", took=LAYER),
    Mistake("half the press stated", read(press=0.5), RIGHT, (PRESS,), reason="the maps are cut at this press"),
    Mistake("double the press stated", read(press=2.0), SAFE, (PRESS,)),
    # mesh
    Mistake("mirrored mesh", scaled(1, 1, -1), ANY, (PART, IMAGES), True, "a part may be its own mirror image"),
    Mistake("mesh 5 % too large", scaled(1.05, 1.05, 1.05), SAFE, (PART, UNITS)),
    Mistake("mesh 5 % too long", scaled(1, 1, 1.05), RIGHT, (PART, UNITS), reason=MISSED),
    Mistake("mesh of another part", take_other, SAFE, (PART,), lost=True),
    Mistake("one touch, mesh of another part", keep_first(take_other), ANY, (PART,), True, "parts have equal edges"),
    Mistake("feature moved by 2 mm", mesh(revise), RIGHT, (PART,), reason=MISSED),
    Mistake("convex hull as mesh", mesh(fill), RIGHT, (PART,), reason=MISSED),
    Mistake("mesh of 60 triangles", mesh(lambda one: simplify_mesh(one, 60)), RIGHT, (PART,), reason=MISSED),
    Mistake("open mesh", mesh(open_up), RIGHT, (PART,), reason=MISSED),
    Mistake("flipped triangles", mesh(lambda one: TriangleMesh(one.vertices_m, one.faces[:, ::-1])), RIGHT, (PART,)),
    # prior
    Mistake("prior 18 mm off", expect(shift(18e-3)), RIGHT, (PRIORS,)),
    Mistake("prior in mm as m", expect(lambda given, T: make_transform(T[:3, :3], 1e3 * T[:3, 3])), RIGHT, (PRIORS,)),
    Mistake("prior's rotation in radians as degrees", expect(turn_as_degrees), RIGHT, (PRIORS,)),
    Mistake("prior in the base frame", expect(lambda given, T: given.truth), RIGHT, (PRIORS,)),
    Mistake("prior of another object", expect(turn_at_random), RIGHT, (PRIORS,)),
    Mistake("3 mm off with a std of 0.3 mm", expect(shift(3e-3), 3e-4), RIGHT, (PRIORS,)),
    # contact masks
    Mistake("masks with double the press", masks(lambda one: one, 2.0), SAFE, (PRESS,)),
    Mistake("inverted masks", masks(np.logical_not), SAFE, (IMAGES,)),
    Mistake("masks too wide", masks(lambda one: binary_dilation(one, iterations=4)), SAFE, (PRESS, IMAGES)),
)
# fmt: on
