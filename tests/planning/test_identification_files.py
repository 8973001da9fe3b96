"""The document of an identification, its next touch, and the objects that explain the touches as well."""

from dataclasses import replace

import numpy as np

from tactile_loc import Identification, KnownObject, PoseModes, choose_next_touch, draw_approaches_to_modes
from tactile_loc.io.json_keys import read_keys
from tactile_loc.planning.identification_files import (
    IDENTIFICATION,
    OBJECT,
    POSE,
    describe_identification,
    list_inseparable,
    write_identification,
)
from tactile_loc.planning.next_touch_files import NEXT_TOUCH, RATED


def test_the_document_states_the_poses_of_each_object_with_their_probabilities(localization):
    probable = KnownObject("hook", 0.9, 0.1, localization)
    others = [replace(probable, name="pin", probability=0.01), KnownObject("nut", 0.0)]
    document = write_identification(Identification((probable, *others), 0.09), [localization.touch])
    hook, pin, nut = document["objects"]
    for one in (hook, pin):
        assert [pose["probability"] for pose in one["poses"]] == [h.probability for h in localization.hypotheses]
    assert nut["poses"] == []
    assert (hook["misfit_nats"], nut["misfit_nats"]) == (0.1, None)
    parts = ((IDENTIFICATION, document), (OBJECT, nut), *((POSE, pose) for pose in pin["poses"]))
    assert all(read_keys(keys, part) == part for keys, part in parts)


def test_the_next_touch_is_written_for_all_probable_objects(localization):
    hook, pin = (KnownObject(name, p, 0.1, localization) for name, p in (("hook", 0.6), ("pin", 0.3)))
    said = Identification((hook, pin, replace(pin, name="nut", probability=0.04)), 0.06)
    modes = PoseModes.of_objects(said)
    assert modes is not None
    assert len(modes.objects) == 2 * len(PoseModes.of(localization).probabilities)
    assert PoseModes.of_objects(Identification((replace(hook, probability=0.01),), 0.99)) is None
    chosen = choose_next_touch(modes, draw_approaches_to_modes(modes, 5, np.random.default_rng(0)))
    written = write_identification(said, [localization.touch], chosen)["next_touch"]
    assert read_keys(NEXT_TOUCH, written) == written
    assert [read_keys(RATED, one)["rank"] for one in written["ranked"]] == [1, 2, 3, 4, 5]


def test_objects_that_explain_the_touches_as_well_are_named(localization):
    first, second, third = (
        KnownObject(name, p, 0.1, localization) for name, p in (("hook", 0.42), ("pin", 0.38), ("nut", 0.15))
    )
    close, clear = Identification((first, second, third), 0.05), Identification((first, third), 0.05)
    assert list_inseparable(close) == ["hook", "pin"]
    assert "hook and pin" in describe_identification(close)
    assert list_inseparable(clear) == []
    assert "apart" not in describe_identification(clear)
