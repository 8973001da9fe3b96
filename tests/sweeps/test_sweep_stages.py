"""What a dry run says is to be built is what is built."""

from __future__ import annotations

from collections import Counter

import pytest

from tactile_loc.store.store import StageStore
from tactile_loc.sweeps.combinations import combine
from tactile_loc.sweeps.plan import Plan
from tactile_loc.sweeps.stages import STAGES, PlannedLocalizer, stages_to_build
from tactile_loc.sweeps.work import Job, work

VALUES = {"object": "pin", "noise": "none", "count": 1}
MOCO = {"name": "moco", "epochs": 1, "queries": 32, "batch": 32, "channels": 4}


@pytest.mark.parametrize(
    ("encoder", "temperature"),
    [([{"name": "pixel", "cells": 12}], {}), ([MOCO], {"temperature": 0.1})],
    ids=["pixel", "moco"],
)
def test_the_planned_keys_are_those_that_are_built(tmp_path, tiny, encoder, temperature):
    if encoder == [MOCO]:
        pytest.importorskip("torch")
    plain = {key: value for key, value in tiny.items() if key != "temperature"}
    combinations, objects = combine(
        Plan.from_values({**plain, **VALUES, "encoder": encoder, "refiner": "none", **temperature})
    )
    (one,), store = combinations, StageStore(tmp_path)
    before = stages_to_build(combinations, objects, tmp_path)
    outcome = work(Job(one.key, one.config, one.count, tmp_path), objects["pin"])
    assert not outcome.error
    built = Counter(name.split()[0] for name in outcome.built)
    assert {**built, "bank": 1} == {stage: count for stage, count in before.items() if count}
    planned = PlannedLocalizer(one.config, objects["pin"], store)
    keys = {str(key) for key in planned.stage_keys()} | {str(planned.evaluation_key(one.count))}
    assert keys <= set(outcome.built)
    assert {name for name in outcome.built if not name.startswith("bank")} <= keys
    assert stages_to_build(combinations, objects, tmp_path) == dict.fromkeys(STAGES, 0)


def test_stages_that_combinations_share_count_once(tmp_path, tiny):
    values = {**tiny, "object": ["pin", "head"], "renderer": ["raycast", "heightmap"], "refiner": ["none", "icp"]}
    combinations, objects = combine(Plan.from_values({**values, "temperature": 0.1}))
    assert stages_to_build(combinations, objects, tmp_path) == {
        "grid": 2, "shapes": 4, "encoder": 0, "bank": 4, "temperature": 0, "evaluation": 8,
    }  # fmt: skip
