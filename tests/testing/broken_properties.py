"""Components that break one property each: BROKEN pairs each property with a component that it must notice."""

from __future__ import annotations

import dataclasses

import numpy as np
from broken_components import drawing, from_the_base, made, moved, sampling, then, turned_about_the_origin

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.plugins.encoders.pixel import PixelEncoder
from tactile_loc.plugins.fusers.product import ProductFuser
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.plugins.grids.whole import WholeGrid
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.plugins.sensors.presets import GelSlim
from tactile_loc.testing import encoders, fusers, grids, matchers, refiners, renderers, sensors
from tactile_loc.testing.problems import ReferenceRenderer, make_plain_object

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def flipped(shape: ContactShape, *_):
    return ContactShape(shape.depth_m[:, ::-1].copy(), shape.press_depth_m)


def cut_out(self, image):
    """Crops the corner of a large image."""
    return GelSlim.contact_shape(self, image[: self.geometry.height_px, : self.geometry.width_px])


SENSOR = [
    (sensors.property_imprint_stays, then(GelSlim, "contact_shape", flipped)),
    (sensors.property_image_size, made(GelSlim, contact_shape=cut_out)),
]


def transposed(self, mesh, T, geometry):
    return ReferenceRenderer.render(self, mesh, make_transform(T[:, :3, :3].swapaxes(1, 2), T[:, :3, 3]), geometry)


def silhouettes(depth, mesh, T, geometry):
    return np.where(np.isfinite(depth), np.float32(geometry.standoff_m), depth)


def shaded_by_its_own_axis(depth, mesh, T, geometry):
    return depth + 1e-4 * T[:, 0, 0, None, None].astype(np.float32)


def nearest_first(depth, *_):
    return depth[np.argsort(np.where(np.isfinite(depth), depth, 0).mean(axis=(1, 2)))]


def beside_by_pixels(self, mesh, T, geometry):
    return ReferenceRenderer.render(self, mesh, T, dataclasses.replace(geometry, cx=geometry.cx + 2))


RENDERER = [
    (renderers.property_object_frame, made(ReferenceRenderer, render=transposed)),
    (renderers.property_mirror_image, made(ReferenceRenderer, render=beside_by_pixels)),
    (renderers.property_mirror_image, drawing(silhouettes)),
    (renderers.property_symmetric_copies, drawing(shaded_by_its_own_axis)),
    (renderers.property_pose_order, drawing(nearest_first)),
    (renderers.property_image_size, made(ReferenceRenderer, render=beside_by_pixels)),
]


def nearly_twice(T, *_):
    return np.concatenate([T, make_translation([2e-4, 0, 0]) @ T])


def places_turned_about_the_origin(places, *_):
    turn = make_transform(rotation_about([1, 2, 3], 0.02), np.zeros(3))
    return dataclasses.replace(places, T_place_object=places.T_place_object @ turn)


def few(grid):
    """The same grid with few directions, for speed."""
    return type(grid)(WholeGrid.Options(directions=1000))


def places_without_symmetry(self, obj, progress):
    return WholeGrid.places(self, make_plain_object(obj.name, obj.mesh), progress)


GRID = [
    (grids.property_object_origin, then(FaceGrid, "sample", lambda T, *_: T[T[:, 0, 3] > 0])),
    (grids.property_symmetric_copies, then(FaceGrid, "sample", nearly_twice)),
    (grids.property_scale, sampling(lambda s: s + 1e-3)),
    (grids.property_place_origin, few(then(WholeGrid, "places", places_turned_about_the_origin))),
    (grids.property_symmetric_places, few(made(WholeGrid, places=places_without_symmetry))),
]


def cropped(self, depth, press, geometry):
    """Crops the corner of a large image."""
    rows, columns = encoders.CAMERA.shape
    return PixelEncoder.encode(self, depth[:, :rows, :columns], press, encoders.CAMERA)


ENCODER = [
    (encoders.property_shape_order, then(PixelEncoder, "encode", lambda e, *_: e - e[:1])),
    (encoders.property_image_size, made(PixelEncoder, encode=cropped)),
    (encoders.property_mirror_image, then(PixelEncoder, "encode", lambda e, *_: np.sort(e, axis=1))),
]


def along_the_axes(self, queries):
    return -0.5 * np.abs(queries[:, None] - self._bank[None]).sum(axis=-1)


MATCHER = [
    (matchers.property_row_order, then(DenseMatcher, "scores", lambda s, _: np.sort(s, axis=1))),
    (matchers.property_query_order, then(DenseMatcher, "scores", lambda s, _: np.sort(s, axis=0))),
    (matchers.property_equal_rows, then(DenseMatcher, "scores", lambda s, _: s - 1e-4 * np.arange(s.shape[1]))),
    (matchers.property_turned_space, made(DenseMatcher, scores=along_the_axes)),
    (matchers.property_unknown_numbers, then(DenseMatcher, "scores", lambda s, q, *_: s - q.sum(axis=1)[:, None])),
    (matchers.property_scale, then(DenseMatcher, "scores", lambda s, _: np.maximum(s, -1))),
]


def towards_its_own_axis(result, *_):
    return moved(result, 3e-4 * result.T_sensor_object[0, 0])


def reflected(result, *_):
    return dataclasses.replace(result, T_sensor_object=result.T_sensor_object @ MIRROR)


REFINER = [
    (refiners.property_object_frame, then(NoRefiner, "refine", turned_about_the_origin)),
    (refiners.property_symmetric_copies, then(NoRefiner, "refine", towards_its_own_axis)),
    (refiners.property_mirrored_part, then(NoRefiner, "refine", reflected)),
    (refiners.property_mirrored_part, then(NoRefiner, "refine", lambda r, *_: moved(r, 0.03))),
]


def from_the_objects_origin(self, posteriors, T_base_sensor, prior=None):
    """Prefers poses whose object's origin is near the sensor's axis."""
    first = posteriors[0]
    return PosePosterior(first.grid, first.log_p - 10 * np.abs(first.grid.T_sensor_object[:, 0, 3]))


def without_symmetry(self, posteriors, T_base_sensor, prior=None):
    """Looks up the second touch by poses alone."""
    first, second = posteriors
    mesh = first.grid.metric.object.mesh
    grid = PoseGrid(second.grid.T_sensor_object, PoseMetric(make_plain_object("asymmetric", mesh)))
    T = np.linalg.inv(T_base_sensor[1]) @ T_base_sensor[0] @ first.grid.T_sensor_object
    return PosePosterior(first.grid, first.log_p + second.log_p[grid.nearest(T)[1]])


FUSER = [
    (fusers.property_object_frame, made(ProductFuser, fuse=from_the_objects_origin)),
    (fusers.property_base_frame, made(ProductFuser, fuse=from_the_base)),
    (fusers.property_touch_order, made(ProductFuser, fuse=lambda self, posteriors, T, prior=None: posteriors[0])),
    (fusers.property_symmetric_copies, made(ProductFuser, fuse=without_symmetry)),
]

BROKEN = [*SENSOR, *RENDERER, *GRID, *ENCODER, *MATCHER, *REFINER, *FUSER]
