"""What is found with the best sensor and press: the best touches, confused pairs of poses, and features, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.commands import format_count
from tactile_loc.plugin import Progress

from tactile_loc_touchability.features import FeatureError, TriedFeature, try_features
from tactile_loc_touchability.rivals import ConfusedPair, find_pairs
from tactile_loc_touchability.study import Study
from tactile_loc_touchability.together import BestTouches, find_best_touches
from tactile_loc_touchability.words import write_share

USUALLY, SELDOM = 0.8, 0.2  # shares above which touches usually determine the pose, and below which they seldom do


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found with the sensor and press of one study: the best touches, confused pairs and tried features.

    `no_feature` states why no feature was tried; empty if some were.
    """

    study: Study
    best: Sequence[BestTouches]
    pairs: Sequence[ConfusedPair]
    features: Sequence[TriedFeature]
    no_feature: str = ""


def find_details(studies: Sequence[Study], out: Path, workers: Any, progress: Progress) -> Findings:
    """Return what is found with the sensor and press whose results most often end certain, with the most touches."""
    study = max(studies, key=lambda one: [(row["certain"], row["right"]) for row in reversed(one.list_shares())])
    best = find_best_touches(study, out, workers, progress)
    with progress.task("comparing poses that touches confuse", 2) as advance:
        pairs = find_pairs(study)
        advance(1)
        if not pairs:
            return Findings(study, best, pairs, (), "No wrong pose explains any touch, so no feature was tried.")
        try:
            features, reason = try_features(study, pairs[0]), ""
        except FeatureError as error:
            features, reason = [], f"{error}."
        advance(1)
    return Findings(study, best, pairs, features, reason)


def give_answer(found: Findings) -> str:
    """Return in one or two sentences whether touch determines the pose of the part."""
    shares = {row["touches"]: row["certain"] for row in found.study.list_shares()}
    enough = next((n for n, share in sorted(shares.items()) if share >= USUALLY), None)
    best = next((one for one in found.best if one.shares["certain"] >= USUALLY), None)
    if enough == 1:
        said = "one touch at a random place usually determines the pose"
    elif enough:
        said = f"{enough} touches at random places usually determine the pose"
    elif best:
        share, most = write_share(best.shares["certain"]), max(shares)
        said = (
            f"{format_count(len(best.presses), 'touch')} at the best places determined the pose in {share} of the "
            f"simulated sets; at random places, {format_count(most, 'touch')} did in {write_share(shares[most])}"
        )
    else:
        highest = max([*shares.values(), *(one.shares["certain"] for one in found.best)])
        said = f"up to three touches determine the pose in at most {write_share(highest)} of the cases"
        if highest < SELDOM:
            said = "up to three touches seldom determine the pose"
    return f"{found.study.name}: {said}."
