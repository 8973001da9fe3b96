"""The outcome of a result: its trees, the shares of its poses, and the shipped model."""

from dataclasses import replace

import numpy as np
import pytest

from tactile_loc.locate.probability.evidence import FEATURES, SURFACE, Evidence, describe_surface
from tactile_loc.locate.probability.outcome_model import FIT_FEATURES, Trees, load_outcome_model, share_outcome
from tactile_loc.locate.result.verdict import Outcome

BASE = np.array([0.3, -0.2, 0.1])


def grow(rng: np.random.Generator, depth: int) -> tuple:
    """Return a random tree: the value of a leaf, or a feature, a threshold and two trees."""
    if depth == 0 or rng.random() < 0.2:
        return (float(rng.normal()),)
    return int(rng.integers(4)), float(rng.normal()), grow(rng, depth - 1), grow(rng, depth - 1)


def descend(tree: tuple, x: np.ndarray) -> float:
    if len(tree) == 1:
        return tree[0]
    feature, threshold, left, right = tree
    return descend(left if x[feature] <= threshold else right, x)


def flatten(trees: list[tuple]) -> Trees:
    nodes: list[tuple] = []

    def add(tree: tuple) -> int:
        number = len(nodes)
        nodes.append((0, 0.0, number, number, tree[0]))
        if len(tree) > 1:
            nodes[number] = (tree[0], tree[1], add(tree[2]), add(tree[3]), 0.0)
        return number

    roots = [add(tree) for tree in trees]
    feature, threshold, left, right, value = (np.array(column) for column in zip(*nodes, strict=True))
    return Trees(BASE, np.array(roots), np.arange(len(trees)) % 3, feature, threshold, left, right, value)


def test_trees_add_the_leaves_that_features_reach_to_the_logits():
    rng = np.random.default_rng(0)
    trees = [grow(rng, 1 + k % 5) for k in range(30)]
    at_threshold = np.full(4, next(tree for tree in trees if len(tree) > 1)[1])
    for x in [*rng.normal(size=(200, 4)), at_threshold]:
        logits = BASE + [sum(descend(tree, x) for tree in trees[k::3]) for k in range(3)]
        assert flatten(trees).predict(x) == pytest.approx(np.exp(logits) / np.exp(logits).sum())


@pytest.mark.parametrize("right", [0.999, 0.95, 0.7, 0.45])
@pytest.mark.parametrize("missed", [0.001, 0.2, 0.5])
def test_the_near_poses_share_the_probability_of_the_first_pose_and_the_order_stays(right, missed):
    rng, near = np.random.default_rng(1), np.array([True, False, True, False, False])
    for _ in range(20):
        weights = np.array([1.0, *-np.sort(-(rng.random(4) ** rng.uniform(0.2, 8)) / 2)])
        p, none = share_outcome(weights, near, Outcome(right * (1 - missed), (1 - right) * (1 - missed), missed))
        assert none == missed
        assert p.sum() + none == pytest.approx(1)
        assert (np.diff(p) <= 0).all()
        assert p[near].sum() / (1 - none) == pytest.approx(right, abs=1e-6)


def test_a_first_pose_that_is_less_probable_than_a_share_is_as_probable_as_the_others():
    p, _ = share_outcome(np.array([0.5, 0.3, 0.2]), np.array([True, False, False]), Outcome(0.1, 0.7, 0.2))
    assert p == pytest.approx(np.full(3, 0.8 / 3))


def test_weights_of_zero_and_one_pose_have_shares():
    p, missed = share_outcome(np.array([1.0, 0.0, 0.0]), np.array([True, False, False]), Outcome(0.6, 0.3, 0.1))
    assert np.isfinite(p).all()
    assert p.sum() + missed == pytest.approx(1)
    p, missed = share_outcome(np.ones(1), np.ones(1, bool), Outcome(0.999, 0.0, 0.001))
    assert (p[0], missed) == pytest.approx((0.999, 0.001))


@pytest.mark.parametrize(
    ("weights", "outcome"), [(np.zeros(3), Outcome(0.6, 0.3, 0.1)), (np.ones(3), Outcome(0, 0, 1))]
)
def test_impossible_poses_have_equal_shares_and_nothing_is_shared_if_all_are_wrong(weights, outcome):
    p, missed = share_outcome(weights, np.array([True, False, False]), outcome)
    assert p == pytest.approx(np.full(3, (1 - missed) / 3))


def make_evidence(fits: np.ndarray, near: tuple[bool, ...] = (True, False), ties: int = 0) -> Evidence:
    values, nothing = np.zeros(len(FEATURES)), np.empty(0)
    return Evidence(values, np.array(near), ties, fits, np.zeros(len(fits)), None, nothing)


def test_the_excess_grows_with_what_a_touch_leaves_unexplained_and_noise_excuses_it(localizer):
    model, excess = load_outcome_model(), []
    for noise in ("none", "strong"):
        surface = np.stack([describe_surface(touch) for touch in localizer.simulate(6, seed=0, noise=noise)])
        first, more = (
            model.measure_excess(make_evidence(np.column_stack([np.full(6, left), surface]))) for left in (-1.0, 0.5)
        )
        assert more - first == pytest.approx(1.5)
        excess.append(first.mean())
    assert excess[0] > excess[1]


def test_the_shipped_model_fits_the_features_and_states_no_certainty():
    model, rng = load_outcome_model(), np.random.default_rng(0)
    assert model.limits.shape == (1 + len(FIT_FEATURES),)
    assert model.trees.feature.max() < len(FEATURES)
    for values in 3 * rng.normal(size=(20, len(FEATURES))):
        outcome = model.predict(replace(make_evidence(np.zeros((1, 1 + len(SURFACE)))), values=values))
        assert sum(vars(outcome).values()) == pytest.approx(1, abs=3e-3)
        assert all(0 < p < 1 for p in vars(outcome).values())
    assert len(model.scores) > 20
    assert ((model.scores >= 0) & (model.scores <= 1)).all()


def test_equal_explanations_are_equally_probable_at_most():
    model, fits = load_outcome_model(), np.zeros((1, 1 + len(SURFACE)))
    alone = model.predict(make_evidence(fits))
    for ties in (1, 3, 50):
        tied = model.predict(make_evidence(fits, ties=ties))
        assert tied.right == pytest.approx(min(alone.right, (1 - alone.missed) / (1 + ties)))
        assert sum(vars(tied).values()) == pytest.approx(sum(vars(alone).values()))


def test_if_all_hypotheses_are_near_no_other_one_can_be_right():
    outcome = load_outcome_model().predict(make_evidence(np.zeros((1, 1 + len(SURFACE))), near=(True, True)))
    assert outcome.another == 0
    assert outcome.right + outcome.missed == pytest.approx(1)
