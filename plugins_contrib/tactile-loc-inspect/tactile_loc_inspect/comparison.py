"""The comparison of one touch with the model: the pose is refined robustly, and each pixel gets a difference.

The model is drawn as the gel would show it, by the solver of the likelihood if the gel is elastic. The pose is refined
until the differences are least, with weights that fall for large differences (Geman and McClure, 1987). So a burr or a
dent hardly moves the pose. A slide along a flat face, which the touch leaves open, stays as it was given.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter, maximum_filter, uniform_filter
from tactile_loc.plugin import ContactShape, Gel, Scene, SensorGeometry, Touch, View
from tactile_loc.plugin.helpers import exponential, invert, logarithm, transform_points

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

PITCH_M = 1.5e-4  # touches are compared on pixels of about this size
BELOW_M = 6e-4  # the model is drawn this much deeper than the touch's deepest point, in case the part has a dent there
ABOVE_M = 8e-4  # and up to this distance from the undeformed gel
NEAR_M = 5e-4  # a larger difference counts as this much in a misfit
PRIOR_STD = np.array([1e-2] * 3 + [3e-4] * 3)  # of the given pose, about and along each axis: radians and metres
STEPS = np.array([2e-3] * 3 + [2e-5] * 3)  # of a twist, for derivatives: radians and metres
PLAIN = (None, None)  # scales of the weights in each round of a fit: of least squares,
ROUGH_M, SCALES_M = (None, None, 2e-4, 1e-4), (1e-4, 5e-5, 3e-5, 3e-5)  # and of both robust fits
BLURS_M = (0.0, 1e-4, 1.5e-4, 2e-4, 3e-4, 4e-4)  # of the sensor, which are tried
BLUR_GAIN = 0.97  # a blur is used if it reduces the misfit to this share
SMOOTHING_M = 1.5e-4  # of both imprints in the fit of the pose, so that outlines have slopes
SPREAD = (0.7, 1.036)  # a quantile of normal errors, and its value in standard deviations
EXACT_M = 3e-6  # least noise of a reading
FLAT_M = 5e-6  # a pixel on a flat or evenly sloped surface is at most this far from the mean of its neighbours
EDGE = 1.5  # error of the height at an edge, as a share of the distance from the mean of the neighbours
RIM_M, RIM_NOISE = 2e-5, 5.0  # a shallower contact may be missed: metres, and in multiples of the noise
STEEPEST = 3.0  # slope above which a surface is not compared
BLURRED_M, BLURRED_EDGE = 2e-5, 0.5  # least noise of a blurred reading, and share of a sharp edge that counts
BORDER_M = 6e-4  # at the border of the gel, a blurred reading is not compared
CORRELATED_M2 = 5e-7  # area in which the error of a reading is the same
TOUCHING_M = 2e-6  # an elastic gel touches the model where its surface is this near
CUTS = (0.25, 0.7)  # least and largest depth at which the reading of an image is cut, as a share of the press
DISTORTION_STD = np.array([0.15] + [3e-5] * 3)  # of a reading from an image: see `TouchImage`
DISTORTION_STEPS = np.array([2e-2] + [1e-5] * 3)  # for derivatives
OUTLINE_M = 4e-4  # error of the contact's outline in a reading from an image
BENT_M = 2e-3  # distance from the gel's middle at which the bends are stated


@dataclass(frozen=True, eq=False)
class Differences:
    """What a touch shows beside the model, each (H, W).

    `height_m`, metres, is the height of the part above the model along the sensor's axis: positive where the part has
    material that the model lacks. It is an estimate at the pixels `known`. At pixels `missed`, only the model touches
    the gel, and at pixels `extra` only the part does. The true difference is then at least as large.
    """

    height_m: Floats
    known: Bools
    missed: Bools
    extra: Bools

    def restrict(self, where: Bools) -> Differences:
        """Return the differences at the pixels of a mask (H, W) only."""
        known = self.known & where
        return Differences(np.where(known, self.height_m, 0), known, self.missed & known, self.extra & known)


@dataclass(frozen=True, eq=False)
class Comparison:
    """A touch beside the model at the refined pose `T` (4, 4), in the frame of the touch's sensor.

    `edge_std_m` and `pose_std_m` (H, W) are the standard deviations of a difference that come from edges and from the
    pose. The model presses the gel by `pressed_m` (H, W). `points_m` and `normals` (H, W, 3) are the model's surface in
    the object's frame. `cosines` (H, W) are those of the angles between the sensor's axis and the normals. `noise_m` is
    the noise of the reading where the surface is flat, and `blur_m` the sensor's blur. `misfit_m` is the mean absolute
    difference in contact, in which large ones count as NEAR_M. All lengths are metres.
    `from_image` states whether the touch was read from an image.
    """

    geometry: SensorGeometry
    T: Floats
    differences: Differences
    edge_std_m: Floats
    pose_std_m: Floats
    pressed_m: Floats
    points_m: Floats
    normals: Floats
    cosines: Floats
    noise_m: float
    blur_m: float
    misfit_m: float
    from_image: bool = False


@dataclass(frozen=True, eq=False)
class TouchImage:
    """A touch with few pixels, and the model's scene with the same pixels.

    `depth_m` (H, W), metres, is the contact shape. The gel is displaced at the pixels `displaced`, and touches the part
    at those `touching`. `press_m` is the indentation of the part's deepest point, and `cut_m` the press depth.

    A reading from an image is distorted. Its `distortion` is the relative error of its heights, and three bends: the
    coefficients of x^2, x y and y^2, metres at the distance BENT_M. It is empty for other readings.
    """

    scene: Scene
    depth_m: Floats
    displaced: Bools
    touching: Bools
    press_m: float
    cut_m: float
    blur_m: float = 0.0
    distortion: tuple[float, ...] = ()

    @classmethod
    def of(cls, view: View) -> TouchImage:
        """Return the touch of a view, with pixels of about PITCH_M."""
        touch = cut_reading(view.touch)
        step = max(1, round(PITCH_M / touch.geometry.pixel_pitch_m))
        geometry, shape = touch.geometry.subsample(step), touch.contact_shape
        scene, depth_m = Scene(view.scene.object, geometry, view.scene.renderer), shape.depth_m[::step, ::step]
        displaced, touching = (
            one.contact[::step, ::step] & geometry.observed_mask for one in (shape, touch.touching_shape)
        )
        distortion = () if touch.image is None else (0.0,) * len(DISTORTION_STD)
        return cls(
            scene, depth_m.astype(float), displaced, touching, shape.deepest_m, shape.press_depth_m, 0.0, distortion
        )

    @property
    def geometry(self) -> SensorGeometry:
        """The sensor with these pixels."""
        return self.scene.geometry

    def draw(self, T_sensor_object: Floats) -> Floats:
        """Return what the gel would show of the model at poses (N, 4, 4): depths (N, H, W), metres.

        Depths are measured as in the contact shape. They go from -BELOW_M to the press plus ABOVE_M, or to the press if
        the gel is elastic.
        """
        return self.soften(self.distort(self.render(T_sensor_object)))

    def render(self, T_sensor_object: Floats) -> Floats:
        """Return the depths (N, H, W), metres, of the model at poses (N, 4, 4), without distortion and blur."""
        deep_m = self.press_m + BELOW_M
        if self.geometry.gel.is_elastic:
            depth_m = self.scene.press(deep_m).render_gel_depths(T_sensor_object)
        else:
            depth_m = self.scene.press(deep_m, deep_m + ABOVE_M).render_contact_depths(T_sensor_object)
        return depth_m.astype(float) - BELOW_M

    def distort(self, depth_m: Floats) -> Floats:
        """Return depths (N, H, W), metres, with the distortion of the reading."""
        if not self.distortion:
            return depth_m
        points = self.geometry.backproject(np.full(self.geometry.shape, self.geometry.surface_m))
        x, y = np.moveaxis((points - self.geometry.gel_middle_m)[..., :2] / BENT_M, -1, 0)
        scale, *bends = self.distortion
        bent_m = np.einsum("i,ihw->hw", bends, np.stack([x * x, x * y, y * y]))
        return np.asarray(self.press_m - (1 + scale) * (self.press_m - depth_m) + bent_m)

    def soften(self, depth_m: Floats) -> Floats:
        """Return depths (N, H, W), metres, as a sensor with the blur shows them."""
        if not self.blur_m:
            return depth_m
        sigma = self.blur_m / self.geometry.pixel_pitch_m
        imprint_m = gaussian_filter(np.maximum(self.press_m - depth_m, 0), (0, sigma, sigma))
        return np.where(imprint_m > 1e-6, self.press_m - imprint_m, np.maximum(depth_m, self.press_m))

    def subtract(self, model_m: Floats, model_touches: Bools) -> Differences:
        """Return the differences from the model's depths (H, W), metres, which touches the gel at `model_touches`."""
        extra, missed = self.touching & ~model_touches, model_touches & ~self.touching
        known = (self.touching | model_touches) & self.geometry.observed_mask
        return Differences(model_m - self.depth_m, known, missed & known, extra & known)

    def find_model_touching(self, model_m: Floats, T: Floats) -> Bools:
        """Mark where the gel touches the model (H, W), given its depths (H, W) at a pose (4, 4), metres."""
        touching = model_m < self.cut_m
        if not self.geometry.gel.is_elastic:
            return touching
        pressed = self.scene.press(self.press_m + BELOW_M)
        rigid_m = pressed.render_contact_depths(T[None])[0].astype(float) - BELOW_M
        sharp_m = dataclasses.replace(self, blur_m=0.0).draw(T[None])[0] if self.blur_m else model_m
        return touching & (rigid_m < sharp_m + TOUCHING_M)

    def compare_everywhere(self, model_m: Floats) -> Differences:
        """Return the differences at all pixels at which the gel is displaced, for the fit of the pose."""
        return dataclasses.replace(self, touching=self.displaced).subtract(model_m, model_m < self.cut_m)


@dataclass(frozen=True, eq=False)
class FittedPose:
    """A pose `T` (4, 4), metres, the model's depths (H, W), metres, and how the pose's error changes them.

    `image` is the touch with its fitted distortion. `J` (6 + D, H, W) are the derivatives of the depths by a twist and
    by the D numbers of the distortion. `covariance` (6 + D, 6 + D) is that of the twist and these numbers.
    """

    image: TouchImage
    T: Floats
    model_m: Floats
    J: Floats
    covariance: Floats


def cut_reading(touch: Touch) -> Touch:
    """Return a touch read from an image as by a rigid gel: cut where the gel leaves the part. Others are unchanged.

    Around the contact, no law of the gel is exact.
    """
    if touch.image is None or not touch.geometry.gel.is_elastic:
        return touch
    shape, observed = touch.contact_shape, touch.geometry.observed_mask
    depths_m = np.sort(shape.depth_m[observed])
    pixels = min(int((touch.touching_shape.contact & observed).sum()), len(depths_m) - 1)
    least_m, most_m = (share * shape.deepest_m for share in CUTS)
    cut_m = min(max(float(depths_m[pixels]), least_m), most_m)
    depth_m = np.where(observed, np.minimum(shape.depth_m, np.float32(cut_m)), np.float32(cut_m))
    rigid = dataclasses.replace(touch.geometry, gel=Gel())
    return dataclasses.replace(touch, contact_shape=ContactShape(depth_m, cut_m, shape.deepest_m), geometry=rigid)


def compare_touches(views: Sequence[View], poses: Sequence[Floats]) -> list[Comparison]:
    """Compare touches of one kind of sensor with the model near poses (4, 4), metres, in the frame of each sensor.

    A blur is used if it explains the touches together clearly better.
    """
    images = [TouchImage.of(view) for view in views]
    rough = [fit_pose(image, T, T, ROUGH_M) for image, T in zip(images, poses, strict=True)]
    misfits = [
        sum(_measure_blurred(image, one.model_m, blur_m) for image, one in zip(images, rough, strict=True))
        for blur_m in BLURS_M
    ]
    best = int(np.argmin(misfits))
    blur_m = BLURS_M[best] if misfits[best] < BLUR_GAIN * misfits[0] else 0.0
    return [
        _compare(fit_pose(dataclasses.replace(one.image, blur_m=blur_m), one.T, T))
        for one, T in zip(rough, poses, strict=True)
    ]


def fit_plain_pose(view: View, T_sensor_object: Floats) -> Floats:
    """Return the pose (4, 4) of least squares near a pose (4, 4), metres: differences of the part move it."""
    return fit_pose(TouchImage.of(view), T_sensor_object, T_sensor_object, PLAIN).T


def _measure_blurred(image: TouchImage, model_m: Floats, blur_m: float) -> float:
    """Return the misfit of the model's depths (H, W), metres, with a blur."""
    blurred = dataclasses.replace(image, blur_m=blur_m)
    return measure_misfit(blurred.compare_everywhere(blurred.soften(model_m[None])[0]))


def _compare(fitted: FittedPose) -> Comparison:
    """Compare a touch with the model at a fitted pose."""
    image = fitted.image
    everywhere = image.compare_everywhere(fitted.model_m)
    rough_m = measure_roughness(fitted.model_m)
    noise_m = measure_noise(everywhere, rough_m)
    if image.geometry.gel.is_elastic:  # where the gel leaves an edge is less exact
        rough_m = maximum_filter(rough_m, 3)
    reliable = np.ones_like(everywhere.known)
    if image.blur_m or image.distortion:
        sharp_m = fitted.model_m
        if image.blur_m:
            sharp_m = dataclasses.replace(image, blur_m=0.0).draw(fitted.T[None])[0]
        rough_m = np.maximum(rough_m, BLURRED_EDGE * measure_roughness(np.minimum(sharp_m, image.press_m)))
        noise_m = max(noise_m, BLURRED_M)
        inside = np.pad(image.geometry.observed_mask, 1)
        reliable = binary_erosion(inside, iterations=1 + round(BORDER_M / image.geometry.pixel_pitch_m))[1:-1, 1:-1]
    found = image.subtract(fitted.model_m, image.find_model_touching(fitted.model_m, fitted.T))
    points_m, normals, cosines = _describe_surface(fitted)
    rim_m = max(RIM_M, RIM_NOISE * noise_m)
    faint = (found.missed & (image.cut_m - fitted.model_m < rim_m)) | (
        found.extra & (image.cut_m - image.depth_m < rim_m)
    )
    found = found.restrict(~faint & reliable & (cosines > 1 / np.hypot(1, STEEPEST)))
    if image.distortion:
        found = found.restrict(~_find_uncertain_outline(found, image.geometry.pixel_pitch_m))
    variance = np.einsum("ihw,ij,jhw->hw", fitted.J, fitted.covariance, fitted.J)
    return Comparison(
        image.geometry,
        fitted.T,
        found,
        EDGE * rough_m,
        np.sqrt(np.maximum(variance, 0)),
        image.cut_m - fitted.model_m,
        points_m,
        normals,
        cosines,
        noise_m,
        image.blur_m,
        measure_misfit(everywhere),
        bool(image.distortion),
    )


def _find_uncertain_outline(found: Differences, pitch_m: float) -> Bools:
    """Mark the pixels (H, W) that only the part touches within OUTLINE_M of where the model touches, or vice versa.

    Pixels have the size `pitch_m`, metres.
    """
    uncertain = np.zeros_like(found.known)
    for alone in (found.missed, found.extra):
        other = found.known & ~alone  # where the one that is missing here touches
        if other.any():
            uncertain |= alone & (distance_transform_edt(~other) * pitch_m < OUTLINE_M)
    return uncertain


def fit_pose(
    image: TouchImage, start: Floats, given: Floats, scales_m: Sequence[float | None] = SCALES_M
) -> FittedPose:
    """Refine a pose `start` (4, 4), metres. The pose `given` (4, 4) holds it where the touch leaves it open.

    Each round has a scale of its weights, metres; None gives all differences their full weight.
    """
    centre, T = image.geometry.gel_middle_m, start
    held = np.diag(1 / np.concatenate([PRIOR_STD, DISTORTION_STD[: len(image.distortion)]]) ** 2)
    for scale_m in scales_m:
        H, g = _weigh(image, _draw_near(image, T, centre), scale_m)
        away = np.concatenate([logarithm(T @ invert(given), centre), image.distortion])
        step = np.linalg.solve(H + held, -(g + held @ away))
        step /= max(1.0, np.abs(step[:6] / (2 * PRIOR_STD)).max())
        T = exponential(step[:6], centre) @ T
        image = dataclasses.replace(image, distortion=tuple(image.distortion + step[6:]))
    drawn = _draw_near(image, T, centre)
    H, _ = _weigh(image, drawn, scales_m[-1])
    J = (drawn[1:] - drawn[0]) / _list_steps(image)[:, None, None]
    return FittedPose(image, T, drawn[0], J, np.asarray(np.linalg.inv(H + held), np.float64))


def _list_steps(image: TouchImage) -> Floats:
    """Return the steps (6 + D,) for derivatives by a twist and by the distortion of a touch."""
    return np.concatenate([STEPS, DISTORTION_STEPS[: len(image.distortion)]])


def _draw_near(image: TouchImage, T: Floats, centre: Floats) -> Floats:
    """Return the model's depths (7 + D, H, W), metres, at a pose (4, 4), after each of STEPS about the centre (3,).

    The last D depths are those after each of DISTORTION_STEPS.
    """
    rendered = image.render(np.concatenate([T[None], exponential(np.diag(STEPS), centre) @ T]))
    moved = np.diag(DISTORTION_STEPS[: len(image.distortion)]) + image.distortion
    distorted = [dataclasses.replace(image, distortion=tuple(one)).distort(rendered[:1]) for one in moved]
    return image.soften(np.concatenate([image.distort(rendered), *distorted]))


def _weigh(image: TouchImage, drawn_m: Floats, scale_m: float | None) -> tuple[Floats, Floats]:
    """Return the information (6 + D, 6 + D) of the differences about the pose and the distortion, and their gradient.

    The model's depths (7 + D, H, W), metres, are those of `_draw_near`. Imprints are smoothed.
    """
    seen_m, model_m = smooth_imprints(image, drawn_m)
    off_m, J = seen_m - model_m[0], (model_m[0] - model_m[1:]) / _list_steps(image)[:, None, None]
    std_m = np.hypot(scale_m or SCALES_M[0], measure_roughness(model_m[0]))
    known = image.geometry.observed_mask & (np.maximum(seen_m, model_m[0]) > 0)
    weights = known / std_m**2 * min(1.0, image.geometry.pixel_pitch_m**2 / CORRELATED_M2)
    if scale_m is not None:
        weights /= (1 + (off_m / std_m) ** 2) ** 2
    rows = J.reshape(len(J), -1)
    weighted = rows * weights.ravel()
    return weighted @ rows.T, weighted @ off_m.ravel()


def smooth_imprints(image: TouchImage, drawn_m: Floats) -> tuple[Floats, Floats]:
    """Return the smoothed imprints of a touch (H, W) and of N drawn depths (N, H, W), all metres."""
    sigma = SMOOTHING_M / image.geometry.pixel_pitch_m
    seen_m = gaussian_filter(np.where(image.displaced, image.cut_m - image.depth_m, 0), sigma)
    return seen_m, np.asarray(gaussian_filter(np.maximum(image.cut_m - drawn_m, 0), (0, sigma, sigma)))


def measure_roughness(depth_m: Floats) -> Floats:
    """Return how far the depths (H, W), metres, near each pixel are from the means of their neighbours.

    It is large at edges and outlines, and nearly zero on smooth slopes.
    """
    return np.asarray(np.abs(depth_m - uniform_filter(depth_m, 3)))


def measure_noise(found: Differences, rough_m: Floats) -> float:
    """Return the noise of a reading, metres: the spread of the differences where the surface has no edge."""
    both = found.known & ~found.missed & ~found.extra
    smooth = both & (rough_m <= max(FLAT_M, float(np.median(rough_m[both])))) if both.any() else both
    if not smooth.any():
        return EXACT_M
    heights_m = found.height_m[smooth]
    off_m = np.abs(heights_m - np.median(heights_m))
    return max(EXACT_M, float(np.quantile(off_m, SPREAD[0])) / SPREAD[1])


def measure_misfit(found: Differences) -> float:
    """Return the mean absolute difference in contact, metres, in which large ones count as NEAR_M."""
    return float(np.minimum(np.abs(found.height_m[found.known]), NEAR_M).mean()) if found.known.any() else NEAR_M


def _describe_surface(fitted: FittedPose) -> tuple[Floats, Floats, Floats]:
    """Return the model's surface in the object's frame: points and normals (H, W, 3), and cosines (H, W).

    Where the model is beyond reach, the points are those of the gel.
    """
    image = fitted.image
    z_m = image.geometry.surface_m - image.press_m + np.minimum(fitted.model_m, image.press_m + ABOVE_M)
    points = image.geometry.backproject(z_m)
    across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normals = np.cross(down, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    inverse = invert(fitted.T)
    return transform_points(inverse, points), normals @ inverse[:3, :3].T, -normals[..., 2]
