"""Render and compare: moves a pose until what the sensor would see of it is what the sensor saw.

Registration compares surfaces where both are in contact. Here every pixel counts, also where there is no contact and
where the sensor ends. Pictures are drawn exactly, triangle by triangle, whatever the scene's renderer: a renderer that
places edges to a fraction of a pixel only would put steps into what is descended.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat

from tactile_loc.plugin import Candidate, ComponentOptions, PoseMetric, Poses, RefinedPose, Refiner, Scene, Touch
from tactile_loc.plugins.refiners.render_descent import Descent
from tactile_loc.plugins.refiners.render_pictures import Pictures, within_reach

ON_THE_WAY, SETTLED = 0.25, 0.1  # steps, of half a blur or pixel: a pose that moves less has settled
ROUGHLY = 0.02  # overlaps are counted in pixels: a loss this small is none
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]


class RenderRefiner(Refiner):
    """Descends from blurred pictures, which show the way from afar, to sharp ones.

    z is free until the last descent, where it follows from contact: the way there would otherwise lead along folds,
    because what touches first changes at once as the object tilts.
    """

    class Options(ComponentOptions):
        """How sharp the pictures are, and how errors of the touch are met."""

        image_px: int = Field(default=200, ge=16, description="the longer image side is thinned to about this, pixels")
        widths_mm: tuple[NonNegativeFloat, ...] = Field(
            default=(1.5, 0.5, 0.0), min_length=1, description="blur (standard deviation) of each descent, mm"
        )
        tolerance: float = Field(
            default=0.1, gt=0, description="indentations that differ by more hardly count, share of the press"
        )
        blurred_tolerance: float = Field(default=0.25, ge=0, description="what each mm of blur adds to the tolerance")
        max_iterations: int = Field(default=8, ge=1, description="iterations a descent")
        patch_mm: float = Field(
            default=3.0, ge=0, description="a touch's errors are alike over this, mm; 0: noise is not reckoned with"
        )
        spread_mm: float = Field(default=2.0, gt=0, description="how far off candidates usually are, mm")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the pose (4, 4), metres, near the candidate's that looks most like the touch.

        A pose that explains the touch worse than the candidate is not returned.
        """
        return self.refine_many(touch, [candidate], scene)[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine candidates of one touch side by side; see `refine`."""
        if len(candidates) == 0:
            return []
        before = np.stack([candidate.T_sensor_object for candidate in candidates])
        start, touching = Scene(scene.object, touch.geometry, scene.renderer).in_contact(before)
        after, settled, iterations = before.copy(), np.zeros(len(before), bool), np.zeros(len(before), np.int64)
        if touching.any():
            found = self._descend(touch, start[touching], scene)
            after[touching], settled[touching], iterations[touching] = found
        return self._no_worse(touch, scene, before, after, settled, iterations)

    def _no_worse(
        self, touch: Touch, scene: Scene, before: Poses, after: Poses, settled: Flags, iterations: Counts
    ) -> list[RefinedPose]:
        """Results of the refined poses, and of the candidates (K, 4, 4) that explain the touch better than theirs."""
        scores = [scene.overlaps_and_explained(T, touch) for T in (before, after)]
        overlaps, explained = (np.stack([both[k] for both in scores]) for k in (0, 1))
        good = (explained[1] >= explained[0]) & (overlaps[1] >= overlaps[0] - ROUGHLY)
        T = np.where(good[:, None, None], after, before)
        fitness = np.where(good, overlaps[1], overlaps[0])
        rows = zip(T, fitness, good & settled, iterations, strict=True)
        return [RefinedPose(pose.copy(), float(fit), bool(ok), int(count)) for pose, fit, ok, count in rows]

    def _descend(self, touch: Touch, T: Poses, scene: Scene) -> tuple[Poses, Flags, Counts]:
        """Poses (K, 4, 4) after all descents, which of them settled in the last (K,), and all iterations (K,)."""
        options, metric = self.options, PoseMetric(scene.object)
        geometry, wanted = touch.thinned(options.image_px)
        still, iterations = np.zeros(len(T), bool), np.zeros(len(T), np.int64)
        if not (wanted.contact & geometry.observed_mask).any():
            return T, still, iterations
        mesh = within_reach(scene.object.mesh, geometry, T)
        start, hold = metric.embed(T), (options.patch_mm / options.spread_mm) ** 2
        for number, width_mm in enumerate(options.widths_mm, start=1):
            last = number == len(options.widths_mm)
            pictures = Pictures.blurred(mesh, geometry, wanted, width_mm * 1e-3, in_contact=last)
            tolerance = options.tolerance + options.blurred_tolerance * width_mm
            descent = Descent(pictures, pictures.of_touch(), tolerance, metric, start, hold)
            T, still, done = descent.run(T, options.max_iterations, SETTLED if last else ON_THE_WAY)
            iterations += done
        return T, still, iterations
