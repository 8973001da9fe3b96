"""The shared colours: verdicts can be read and told apart."""

import itertools

import numpy as np
import pytest

from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.view.palette import DARK, LIGHT, Palette

RED_BLIND = np.array([[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]])
"""Linear red, green and blue as people without red cones see them (Machado, Oliveira and Fernandes 2009)."""


def linear(colour: str) -> np.ndarray:
    c = Palette.rgb(colour)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    a, b = sorted(linear(colour) @ [0.2126, 0.7152, 0.0722] for colour in (one, other))
    return float((b + 0.05) / (a + 0.05))


@pytest.mark.parametrize("verdict", Verdict)
def test_white_text_on_a_verdict_is_readable(verdict):
    assert contrast(LIGHT.find_verdict(verdict), "#ffffff") >= 4.5


@pytest.mark.parametrize("palette", [LIGHT, DARK])
def test_text_is_readable_on_its_paper(palette):
    assert contrast(palette.ink, palette.paper) >= 7
    assert contrast(palette.soft, palette.paper) >= 4.5


def test_colours_differ_without_red_cones():
    names = [LIGHT.find_verdict(one) for one in (Verdict.CERTAIN, Verdict.AMBIGUOUS, Verdict.POOR_FIT)]
    for group in ([LIGHT.best, LIGHT.truth], names):
        for one, other in itertools.combinations(group, 2):
            assert np.abs(RED_BLIND @ (linear(one) - linear(other))).max() > 0.05
