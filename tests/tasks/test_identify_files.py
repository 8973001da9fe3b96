"""The record of an identification states the probabilities of poses only if they were fitted to the object."""

from __future__ import annotations

from dataclasses import replace

from tactile_loc.tasks.identify import Identification, KnownObject
from tactile_loc.tasks.identify_files import IdentificationRecord, make_identification_record


def test_probabilities_that_were_not_fitted_are_left_out(localization):
    probable = KnownObject("hook", 0.9, 1.0, 0.9, 0.1, localization)
    others = [replace(probable, name="pin", probability=0.01, fitted=False), KnownObject("nut", 0, 1, 0, 9.0, None)]
    record = make_identification_record(Identification((probable, *others), 0.09), ["touch"])
    hook, pin, nut = record.objects
    assert [pose.probability for pose in hook.poses] == [h.probability for h in localization.hypotheses]
    assert len(pin.poses) == len(hook.poses)
    assert {pose.probability for pose in pin.poses} == {None}
    assert nut.poses == []
    assert IdentificationRecord.model_validate_json(record.model_dump_json()) == record
