"""The next touch: the approach with the greatest information gain about the modes, for its cost.

For each approach and mode, the sensor's travel up to contact and the contact itself are computed. If mode i is true,
both give a number of nats of evidence against each mode j. This evidence determines the entropy that remains if mode i
is true. An approach is rated by the mean of this entropy over the modes (Lindley, 1956).

Locating several touches together moves each pose until it fits all of them as well as it can. So a real touch
contradicts a wrong pose less than the expected touch does, and only a share of the evidence is expected (`CAUTIOUS`).
To decide which modes no touch distinguishes, all of it counts (`FULL`).
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Ints, invert
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.gel_surface import deform_gel, mark_touching
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.approach_files import Approach
from tactile_loc.locate.result.localization import Localization
from tactile_loc.planning.clearance import Clearance
from tactile_loc.planning.touch_evidence import compare_contacts, compare_elastic_contacts
from tactile_loc.slots.registry import registry
from tactile_loc.slots.renderer import Renderer
from tactile_loc.tracking.pose_modes import PoseModes, compute_entropy

LOOKED_AT_PX = 24  # pixels along the long side of contacts that are compared
MOST_DRAWN = 1500  # approaches whose contacts are rendered: the best ones by travel alone
AT_ONCE = 500  # contacts rendered together
MOST_NATS = 8.0  # most evidence of one touch between two modes, because real touches differ from expected ones
ALIKE_NATS = 1.0  # modes are alike if no approach gives more evidence between them
LEAST_PERCENT = 0.25  # of the observed pixels: a touch needs at least this contact
IN_THE_WAY = 0.01  # an approach is out of reach if it starts inside the object with this probability
MOST_UNLISTED = 0.25  # probability of unlisted poses above which another touch is always worth making


Cost = Callable[[Approach], float]


class Weights(NamedTuple):
    """How much is expected of a touch: the weight of a contact's evidence, and the standard deviation of the travel.

    `travel_std_m`, metres, contains the errors of the mode's pose, of the press and of the robot. A touch with a
    contact of `half_m2`, square metres, counts as located half of the time, because noise hides small contacts.
    """

    contact: float
    travel_std_m: float
    half_m2: float


CAUTIOUS, FULL = Weights(0.15, 5e-3, 1e-5), Weights(1.0, 5e-4, 0.0)
MOTION = 0.5  # share of an approach's cost that is paid even if it makes no touch


@dataclass(frozen=True, eq=False)
class Foreseen:
    """The encounters of A approaches with the object, for each of K modes as the true one.

    `T_sensor_object` (A, K, 4, 4), metres, is the object's pose in the frame of the pressed sensor. `travel_m` (A, K),
    metres, is the sensor's travel up to contact. `meets` (A, K) is true where the sensor touches the object on its way.
    `blocked` (A, K) is true where the sensor's gel starts inside or beyond the object.
    """

    T_sensor_object: Floats
    travel_m: Floats
    meets: Bools
    blocked: Bools


@dataclass(frozen=True, eq=False)
class RatedApproach:
    """An approach and its expected result.

    `information`, nats, is the expected decrease of the modes' entropy, and `entropy`, nats, the entropy that remains.
    `safe`, nats, is the decrease that is expected if touches tell less, as real ones do (`CAUTIOUS`).
    `meets`, 0 to 1, is the probability that the approach makes a touch. `travel_m` (K,), metres, is the travel up to
    contact with each mode, NaN if the sensor misses the object.
    """

    approach: Approach
    information: float
    safe: float
    entropy: float
    meets: float
    travel_m: Floats
    cost: float

    @property
    def worth(self) -> float:
        """Safe information divided by the expected cost, by which approaches are ranked.

        An approach costs its motion, and the rest of its cost only if it makes a touch.
        """
        return self.safe / (self.cost * (MOTION + (1 - MOTION) * self.meets))


@dataclass(frozen=True, eq=False)
class NextTouch:
    """Approaches, the best first, and the approaches `out_of_reach`, each with the reason."""

    modes: PoseModes
    ranked: tuple[RatedApproach, ...]
    out_of_reach: tuple[tuple[Approach, str], ...]
    scene: Scene

    @property
    def best(self) -> RatedApproach:
        """The approach with the most safe information for its cost."""
        return self.ranked[0]

    @cached_property
    def alike(self) -> tuple[tuple[int, ...], ...]:
        """Groups of modes, numbered from 0, that no approach can distinguish; the largest first."""
        count = len(self.modes.probabilities)
        apart, at_once = np.zeros((count, count)), max(1, MOST_DRAWN // count)
        for start in range(0, len(self.ranked), at_once):
            some = [rated.approach for rated in self.ranked[start : start + at_once]]
            seen = foresee(self.scene, self.modes, some)
            ((nats, located),) = _compare_drawn(self.scene, some, seen, self.modes, [FULL])
            apart = np.maximum(apart, (nats * located[:, :, None]).max(axis=0))
        return find_groups(apart < ALIKE_NATS)

    @cached_property
    def stops(self) -> bool:
        """Whether no approach distinguishes any two probable modes, so that none of these touches can help.

        It is false if only one mode is probable, or if unlisted poses have more than MOST_UNLISTED of the probability.
        """
        probable = set(np.flatnonzero(self.modes.probabilities > IN_THE_WAY).tolist())
        alone = self.modes.unlisted > MOST_UNLISTED or len(probable) < 2
        return not alone and any(probable <= set(group) for group in self.alike)

    @property
    def doubt_left(self) -> float:
        """The probability that the true mode is in a group of `alike`, but is not the likeliest mode of its group."""
        p = self.modes.probabilities
        return float(sum(p[list(group)].sum() - p[list(group)].max() for group in self.alike))

    def contacts(self, rated: RatedApproach) -> Float32:
        """Return the contact depths (K, H, W), metres, that the sensor would see of each mode.

        The press depth means that the gel is not displaced.
        """
        seen = foresee(self.scene, self.modes, [rated.approach])
        scene = self.scene.press(_find_press_m(rated.approach, self.modes))
        depths = np.full((len(self.modes.probabilities), *scene.geometry.shape), scene.geometry.max_depth_m, np.float32)
        met = seen.meets[0]
        for obj, own in self.modes.by_object:
            if len(some := own[met[own]]):
                own_scene = dataclasses.replace(scene, object=obj)
                depths[some] = own_scene.render_gel_depths(seen.T_sensor_object[0, some])
        return depths


def choose_next_touch(
    found: Localization | PoseModes,
    approaches: Sequence[Approach | Floats],
    cost: Cost | None = None,
    renderer: Renderer | None = None,
    clearance: Clearance | None = None,
) -> NextTouch:
    """Rate approaches by the entropy of the modes of `found` that is expected after each approach.

    An approach can also be just the pose (4, 4), metres, at which the sensor starts. Poses are in the frame of the
    touch's `T_base_sensor` or, without it, in the touch's sensor frame. `cost` replaces the approaches' own costs;
    infinity means out of reach. With a `clearance`, approaches are also out of reach if the finger would hit something.

    A press gives no information if the sensor misses the object or touches only a flat face, because such a touch
    cannot be located. The travel up to contact gives information, too, because it differs between modes. Raises
    ConfigError if there is no approach, if none is within reach, or if a cost or press is invalid.
    """
    modes = found if isinstance(found, PoseModes) else PoseModes.of(found)
    scene = Scene(modes.objects[0], modes.geometry, renderer or registry().create("renderer", "heightmap", {}))
    if not len(approaches):
        raise ConfigError("there is no approach to choose from; give at least one")
    made = [a if isinstance(a, Approach) else Approach(a, name=str(k)) for k, a in enumerate(approaches, 1)]
    costs = np.array([approach.cost if cost is None else cost(approach) for approach in made], float)
    _require_usable(made, costs, modes)
    seen = foresee(scene, modes, made)
    reasons = _explain_out_of_reach(seen, modes, costs)
    if clearance is not None:
        _add_collisions(reasons, clearance, made, seen, modes)
    left = [k for k, reason in enumerate(reasons) if not reason]
    outside = tuple((made[k], reason) for k, reason in enumerate(reasons) if reason)
    if not left:
        raise ConfigError(f"none of the {len(made)} approaches is within reach; the first {reasons[0]}")
    entropies = _expect_entropies(scene, [made[k] for k in left], _select(seen, left), modes, costs[left])
    rated = [
        RatedApproach(
            made[k],
            max(0.0, modes.entropy - full),
            max(0.0, modes.entropy - cautious),
            full,
            float(modes.probabilities[seen.meets[k]].sum()),
            np.where(seen.meets[k], seen.travel_m[k], np.nan),
            float(costs[k]),
        )
        for k, (full, cautious) in zip(left, entropies.tolist(), strict=True)
    ]
    order = sorted(range(len(rated)), key=lambda k: (-rated[k].worth, rated[k].cost))
    return NextTouch(modes, tuple(rated[k] for k in order), outside, scene)


def foresee(scene: Scene, modes: PoseModes, approaches: Sequence[Approach]) -> Foreseen:
    """Return the encounters of approaches with the object, for each mode as the true one."""
    T = invert(np.stack([a.T_base_sensor for a in approaches]))[:, None] @ modes.T_base_object[None]
    bare = dataclasses.replace(scene.geometry, standoff_m=scene.geometry.surface_m, indentation_m=0.0)  # unpressed
    T_contact, over = np.empty_like(T), np.empty(T.shape[:2], bool)
    for obj, own in modes.by_object:
        some = T[:, own]
        touching, met = dataclasses.replace(scene, object=obj, geometry=bare).bring_to_contact(some.reshape(-1, 4, 4))
        T_contact[:, own], over[:, own] = touching.reshape(some.shape), met.reshape(some.shape[:2])
    travel_m = T[..., 2, 3] - T_contact[..., 2, 3]
    T_contact[..., 2, 3] -= np.array([_find_press_m(a, modes) for a in approaches])[:, None]
    longest_m = np.array([a.travel_m for a in approaches])[:, None]
    return Foreseen(T_contact, travel_m, over & (travel_m >= 0) & (travel_m <= longest_m), over & (travel_m < 0))


def compute_expected_entropy(nats: Floats, probabilities: Floats, located: Floats) -> Floats:
    """Return the entropy (A,), nats, expected after each of A touches, for modes with probabilities (K,).

    `nats` (A, K, K) is the evidence that the touch of mode i gives for mode i against mode j. `located` (A, K), 0 to 1,
    is how probably the touch of each mode can be located; other touches change nothing.
    """
    with np.errstate(divide="ignore"):
        logits = np.log(probabilities) - nats
    after = np.exp(logits - logits.max(axis=-1, keepdims=True))
    left, before = compute_entropy(after / after.sum(axis=-1, keepdims=True)), compute_entropy(probabilities)
    return np.asarray((before - located * (before - left)) @ probabilities)


def find_groups(alike: Bools) -> tuple[tuple[int, ...], ...]:
    """Return the groups of two or more of K items that are `alike` (K, K), the largest first.

    Two items of a group may be alike only through other items.
    """
    from scipy.sparse.csgraph import connected_components

    _, label = connected_components(alike, directed=False)
    found = [tuple(np.flatnonzero(label == k).tolist()) for k in np.unique(label)]
    return tuple(sorted((group for group in found if len(group) > 1), key=len, reverse=True))


def _expect_entropies(
    scene: Scene, approaches: Sequence[Approach], seen: Foreseen, modes: PoseModes, costs: Floats
) -> Floats:
    """Return the expected entropy (A, 2), nats, with full and with cautious weights.

    All approaches are rated by travel, and the most promising ones by contact as well.
    """
    p, several = modes.probabilities, (_weigh_fully(modes), CAUTIOUS)
    meets = seen.meets.astype(float)
    after = np.stack([compute_expected_entropy(_compare_travels(seen, w.travel_std_m), p, meets) for w in several], 1)
    worth = (modes.entropy - after[:, 1]) / (costs * (MOTION + (1 - MOTION) * (meets @ p)))
    promising = np.argsort(-worth, kind="stable")[: max(1, MOST_DRAWN // len(p))]
    drawn = _compare_drawn(scene, [approaches[k] for k in promising], _select(seen, promising), modes, several)
    after[promising] = np.stack([compute_expected_entropy(nats, p, located) for nats, located in drawn], 1)
    return after


def _weigh_fully(modes: PoseModes) -> Weights:
    return FULL._replace(contact=modes.sharpness)


def _compare_drawn(
    scene: Scene, approaches: Sequence[Approach], seen: Foreseen, modes: PoseModes, several: Sequence[Weights]
) -> list[tuple[Floats, Floats]]:
    """Return the arguments `nats` and `located` of `compute_expected_entropy` for each of several weights.

    They come from travels and rendered contacts.
    """
    found = [(_compare_travels(seen, weights.travel_std_m), seen.meets.astype(float)) for weights in several]
    for press_m in {_find_press_m(a, modes) for a in approaches}:
        some = [k for k, a in enumerate(approaches) if _find_press_m(a, modes) == press_m]
        geometry = scene.geometry.press(press_m)
        step = max(1, round(max(geometry.shape) / LOOKED_AT_PX))
        glance = dataclasses.replace(scene, geometry=geometry.subsample(step))
        observed, pitch_m = glance.geometry.observed_mask, glance.geometry.pixel_pitch_m
        for k, (rows, depths) in zip(some, _draw(glance, modes, _select(seen, some)), strict=True):
            if not len(rows):
                continue
            contacts = depths
            if geometry.gel.is_elastic:
                shown = deform_gel(depths, press_m, glance.geometry)
                contacts = np.where(mark_touching(depths, shown, press_m), depths, np.float32(press_m))
                told = compare_elastic_contacts(depths, shown, press_m, observed, pitch_m)
            else:
                told = compare_contacts(depths, press_m, observed, pitch_m)
            for weights, (nats, located) in zip(several, found, strict=True):
                nats[k][np.ix_(rows, rows)] += weights.contact * told
                located[k, rows] = _expect_located(contacts, glance.geometry, weights.half_m2)
    return [(np.minimum(nats, MOST_NATS), located) for nats, located in found]


def _draw(glance: Scene, modes: PoseModes, seen: Foreseen) -> list[tuple[Ints, Float32]]:
    """Return the modes that each approach meets, and the contact depths (M, h, w), metres, that they would make."""
    poses, of = seen.T_sensor_object[seen.meets], np.nonzero(seen.meets)[1]
    every = np.empty((len(poses), *glance.geometry.shape), np.float32)
    for obj, own in modes.by_object:
        scene, drawn = dataclasses.replace(glance, object=obj), np.flatnonzero(np.isin(of, own))
        for some in (drawn[start : start + AT_ONCE] for start in range(0, len(drawn), AT_ONCE)):
            every[some] = scene.render_contact_depths(poses[some])
    ends = np.cumsum(seen.meets.sum(axis=1))
    return [(np.flatnonzero(meets), some) for meets, some in zip(seen.meets, np.split(every, ends[:-1]), strict=True)]


def _expect_located(depth_m: Float32, geometry: SensorGeometry, half_m2: float) -> Floats:
    """Return how probably contacts (M, h, w) can be located, 0 to 1: see `Weights`.

    It is 0 for a contact that is too small for a touch, and for a flat face all over the sensor.
    """
    seen = depth_m[:, geometry.observed_mask]
    count = (seen < np.float32(geometry.max_depth_m)).sum(axis=1)
    usable = (count >= LEAST_PERCENT / 100 * seen.shape[1]) & (count < seen.shape[1])
    area_m2 = count * geometry.pixel_pitch_m**2
    return np.asarray(np.where(usable, area_m2 / np.where(usable, area_m2 + half_m2, 1.0), 0.0))


def _compare_travels(seen: Foreseen, std_m: float) -> Floats:
    """Return the evidence (A, K, K), nats, of the travel for mode i against mode j."""
    apart_m = seen.travel_m[:, :, None] - seen.travel_m[:, None, :]
    both = seen.meets[:, :, None] & seen.meets[:, None, :]
    either = seen.meets[:, :, None] | seen.meets[:, None, :]
    nats = np.where(both, 0.5 * (np.where(both, apart_m, 0.0) / std_m) ** 2, np.where(either, MOST_NATS, 0.0))
    return np.asarray(np.minimum(nats, MOST_NATS))


def _explain_out_of_reach(seen: Foreseen, modes: PoseModes, costs: Floats) -> list[str]:
    """Return the reason why each approach (A,) cannot be made; "" if it can be made."""
    inside = seen.blocked @ modes.probabilities
    return [
        "has an infinite cost"
        if np.isinf(price)
        else f"would start inside or behind the object, with {100 * share:.0f} % probability"
        if share > IN_THE_WAY
        else ""
        for price, share in zip(costs, inside, strict=True)
    ]


def _add_collisions(
    reasons: list[str], clearance: Clearance, approaches: Sequence[Approach], seen: Foreseen, modes: PoseModes
) -> None:
    """Fill the empty ones of `reasons` (A,) with what the finger would hit."""
    left = [k for k, reason in enumerate(reasons) if not reason]
    some, met = [approaches[k] for k in left], _select(seen, left)
    pressed_m = met.travel_m + np.array([_find_press_m(a, modes) for a in some])[:, None]
    moved_m = np.where(met.meets, pressed_m, np.array([a.travel_m for a in some])[:, None])
    for k, reason in zip(left, clearance.explain(modes, some, moved_m), strict=True):
        reasons[k] = reason


def _require_usable(approaches: Sequence[Approach], costs: Floats, modes: PoseModes) -> None:
    for number, (approach, price) in enumerate(zip(approaches, costs, strict=True), start=1):
        name = approach.name or f"approach {number}"
        if not price > 0:
            raise ConfigError(f"{name} costs {price:g}; give a cost above 0, or infinity if it is out of reach")
        press_m = _find_press_m(approach, modes)
        if not 0 < press_m < modes.geometry.surface_m:
            raise ConfigError(
                f"{name} presses by {1e3 * press_m:.3g} mm; give more than 0 and less than "
                f"{1e3 * modes.geometry.surface_m:.3g} mm"
            )


def _find_press_m(approach: Approach, modes: PoseModes) -> float:
    return modes.press_m if approach.press_m is None else approach.press_m


def _select(seen: Foreseen, which: Sequence[int] | Ints) -> Foreseen:
    return Foreseen(*(getattr(seen, field.name)[which] for field in dataclasses.fields(seen)))
