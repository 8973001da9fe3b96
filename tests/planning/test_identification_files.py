"""The record of an identification states the probabilities of poses only if they were fitted to the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactile_loc.locate.identify import Identification, KnownObject
from tactile_loc.planning.approaches import draw_approaches_to_modes
from tactile_loc.planning.identification_files import IdentificationRecord, make_identification_record
from tactile_loc.planning.next_touch import choose_next_touch
from tactile_loc.tracking.pose_modes import PoseModes


def test_probabilities_that_were_not_fitted_are_left_out(localization):
    probable = KnownObject("hook", 0.9, 0.1, localization, fitted=True)
    others = [replace(probable, name="pin", probability=0.01, fitted=False), KnownObject("nut", 0.0)]
    record = make_identification_record(Identification((probable, *others), 0.09), ["touch"])
    hook, pin, nut = record.objects
    assert [pose.probability for pose in hook.poses] == [h.probability for h in localization.hypotheses]
    assert len(pin.poses) == len(hook.poses)
    assert {pose.probability for pose in pin.poses} == {None}
    assert nut.poses == []
    assert (hook.misfit_nats, nut.misfit_nats) == (0.1, None)
    assert IdentificationRecord.model_validate_json(record.model_dump_json()) == record


def test_the_next_touch_is_recorded_for_all_probable_objects(localization):
    hook, pin = (KnownObject(name, p, 0.1, localization, fitted=True) for name, p in (("hook", 0.6), ("pin", 0.3)))
    said = Identification((hook, pin, replace(pin, name="nut", probability=0.04)), 0.06)
    modes = PoseModes.of_objects(said)
    assert modes is not None
    assert len(modes.objects) == 2 * len(PoseModes.of(localization).probabilities)
    assert PoseModes.of_objects(Identification((replace(hook, probability=0.01),), 0.99)) is None
    approaches = draw_approaches_to_modes(modes, 5, np.random.default_rng(0))
    record = make_identification_record(said, ["touch"], choose_next_touch(modes, approaches))
    assert record.next_touch is not None
    assert len(record.next_touch["ranked"]) == 5
    assert IdentificationRecord.model_validate_json(record.model_dump_json()) == record


def test_objects_that_explain_the_touches_as_well_are_named(localization):
    first, second, third = (
        KnownObject(name, p, 0.1, localization, fitted=True)
        for name, p in (("hook", 0.42), ("pin", 0.38), ("nut", 0.15))
    )
    close = make_identification_record(Identification((first, second, third), 0.05), ["touch"])
    assert close.inseparable == ["hook", "pin"]
    assert "hook and pin" in close.summary()
    clear = make_identification_record(Identification((first, third), 0.05), ["touch"])
    assert clear.inseparable == []
    assert "apart" not in clear.summary()
