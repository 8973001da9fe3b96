"""The exact renderers draw the depths that follow from geometry, far within the tolerance of the contract checks."""

from __future__ import annotations

import pytest

from tactile_loc.testing import renderers


@pytest.mark.parametrize(
    ("check", "tolerance_m"),
    [(renderers.check_plane, 1e-7), (renderers.check_sphere, 5e-6)],  # the sphere's facets are up to 2.5 um inside it
    ids=lambda x: getattr(x, "name", ""),
)
def test_depths_are_exact(exact_renderer, monkeypatch, check, tolerance_m):
    monkeypatch.setattr(renderers, "TOLERANCE_M", tolerance_m)
    monkeypatch.setattr(renderers, "MEAN_TOLERANCE_M", tolerance_m)
    check(exact_renderer)
