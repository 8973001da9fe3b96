"""The fit of "none of these" to touches of known and of left-out objects."""

import numpy as np

from tactile_loc_library.null_fit import KnownAnswer, fit_null_evidence


def test_the_null_evidence_is_fitted_to_known_and_unknown_objects():
    rng = np.random.default_rng(0)
    answers = []
    for touches in (1, 2, 3):
        for _ in range(40):
            floors = rng.uniform(0, 4, touches)
            own, other = rng.uniform(0, 2, 1), rng.uniform(4, 9, 3) + (touches > 1) * 8
            if touches > 1 and rng.random() < 0.3:
                other[0] = rng.uniform(0, 2)  # as well by chance
            answers.append(KnownAnswer(floors.sum() + np.concatenate([own, other]), floors, 0))
            answers.append(KnownAnswer(floors.sum() + other, floors, -1, left_out=True))
    null = fit_null_evidence(answers, prior=0.3)
    assert null.prior == 0.3
    assert 2 < null.gap * (1 + 4 * null.growth) < 12
    assert 0.15 < null.chance * null.again < 0.45
    betrayed = [a for a in answers if a.left_out and len(a.floors) > 1 and a.misfits.min() - a.floors.sum() > 8]
    assert len(betrayed) > 30
    assert all(null.probabilities(a.misfits, a.floors)[1] > 0.8 for a in betrayed)
