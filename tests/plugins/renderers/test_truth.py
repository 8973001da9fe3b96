"""The exact renderers draw the depths that follow from geometry, far within the tolerance of the contract checks."""

from tactile_loc.testing import renderers


def test_a_tilted_plane_has_its_depth_to_a_tenth_of_a_micrometre(exact_renderer, monkeypatch):
    monkeypatch.setattr(renderers, "TOLERANCE_M", 1e-7)
    renderers.check_plane(exact_renderer)
