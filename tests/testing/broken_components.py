"""Components that break one contract each: BROKEN pairs each check or property with a component that it must notice."""

import dataclasses
from typing import Any

import numpy as np
from pydantic import ConfigDict

from tactile_loc import ContactShape, PoseGrid, PoseMetric, PosePosterior, TriangleMesh
from tactile_loc.bases.all_rotations import find_centroid_range
from tactile_loc.plugin import Capabilities, ComponentOptions, ConfigError, DepthFiles, RefinedPose
from tactile_loc.plugin.helpers import make_transform, make_translation, rotation_about
from tactile_loc.plugins.encoders.pixel import PixelEncoder
from tactile_loc.plugins.fusers.kinematic import KinematicFuser
from tactile_loc.plugins.fusers.product import ProductFuser
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.plugins.grids.whole import WholeGrid
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.plugins.matchers.faiss import FaissMatcher
from tactile_loc.plugins.refiners.icp import IcpRefiner
from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.plugins.sensors.presets import GelSlim
from tactile_loc.testing import contract, encoders, fusers, grids, matchers, refiners, renderers, sensors
from tactile_loc.testing.problems import ReferenceRenderer, make_plain_object

INFINITE = np.float32(np.inf)
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
DEFAULT = Capabilities()


def made(base: type, **members: Any) -> Any:
    """An instance of a subclass of `base` with other members."""
    return type(f"Broken{base.__name__}", (base,), members)()


def then(base: type, method: str, change: Any) -> Any:
    """A component whose `method` returns change(result, *arguments)."""
    original = getattr(base, method)
    return made(base, **{method: lambda self, *args: change(original(self, *args), *args)})


def drifting(base: type, method: str, change: Any) -> Any:
    """A component whose `method` returns change(result, number of the call)."""
    calls = iter(range(1000))
    return then(base, method, lambda result, *args: change(result, next(calls)))


def scribbled(result: Any, array: np.ndarray) -> Any:
    """Write to an array of the caller."""
    array.flat[0] = 0.123
    return result


class Undescribed(ComponentOptions):
    size_mm: float = 1.0


class Loose(ComponentOptions):
    model_config = ConfigDict(frozen=False, extra="ignore")


COMMON = [
    (contract.check_declaration, made(DenseMatcher, slot="tracker")),
    (contract.check_options_are_strict, made(DenseMatcher, Options=Loose)),
    (contract.check_options_are_described, made(DenseMatcher, Options=Undescribed)),
    (contract.check_describe_is_json, made(DenseMatcher, describe=lambda self: {"size": np.float32(1)})),
    (contract.check_describe_is_json, made(DenseMatcher, describe=lambda self: {"me": id(self)})),
    (contract.check_describe_is_json, made(DenseMatcher, describe=lambda self: {"class": "DenseMatcher"})),
    (contract.check_describe_names_every_option, made(FaceGrid, describe=lambda self: {"class": "FaceGrid"})),
]


def in_millimetres(geometry):
    k = 1e3
    return dataclasses.replace(geometry, standoff_m=geometry.standoff_m * k, max_depth_m=geometry.max_depth_m * k)


def deeper(shape: ContactShape, factor: float) -> ContactShape:
    return ContactShape((shape.depth_m * factor).astype(np.float32), shape.press_depth_m)


def anything_goes(self, image):
    return ContactShape(np.zeros(self.geometry.shape, np.float32), self.geometry.max_depth_m)


def flipped(shape: ContactShape, *_):
    return ContactShape(shape.depth_m[:, ::-1].copy(), shape.press_depth_m)


def cut_out(self, image):
    """Crops the corner of a large image."""
    return GelSlim.contact_shape(self, image[: self.geometry.height_px, : self.geometry.width_px])


SENSOR = [
    (sensors.check_depths_are_kept, then(GelSlim, "contact_shape", flipped)),
    (sensors.property_image_size, made(GelSlim, contact_shape=cut_out)),
    (sensors.check_geometry, made(GelSlim, geometry=property(lambda self: in_millimetres(self._geometry)))),
    (sensors.check_depth_files, made(GelSlim, depth_files=DepthFiles(unit="inch"))),
    (sensors.check_contact_shape, then(GelSlim, "contact_shape", lambda s, _: ContactShape(s.depth_m[::2], 2e-3))),
    (sensors.check_contact_shape, then(GelSlim, "contact_shape", lambda s, _: deeper(s, 1.5))),
    (sensors.check_depths_are_kept, then(GelSlim, "contact_shape", lambda s, _: deeper(s, 0.9))),
    (sensors.check_observation_untouched, then(GelSlim, "contact_shape", scribbled)),
    (sensors.check_refuses_nonsense, made(GelSlim, contact_shape=anything_goes)),
    (sensors.check_deterministic, drifting(GelSlim, "contact_shape", lambda s, n: deeper(s, 1 - 1e-3 * n))),
]


def off_by_half_a_pixel(self, mesh, T, geometry):
    return ReferenceRenderer.render(self, mesh, T, dataclasses.replace(geometry, cx=geometry.cx + 0.5))


def along_the_ray(depth, mesh, T, geometry):
    x, y = np.meshgrid(*geometry.pixel_slopes)
    return depth * np.float32(np.sqrt(1 + x**2 + y**2)) if geometry.is_pinhole else depth


def without_the_boss(self, mesh, T, geometry):
    return ReferenceRenderer.render(
        self, TriangleMesh(mesh.vertices_m, np.delete(mesh.faces, slice(12, 24), 0)), T, geometry
    )


def drawing(change):
    return then(ReferenceRenderer, "render", change)


def transposed(self, mesh, T, geometry):
    return ReferenceRenderer.render(self, mesh, make_transform(T[:, :3, :3].swapaxes(1, 2), T[:, :3, 3]), geometry)


def silhouettes(depth, mesh, T, geometry):
    return np.where(np.isfinite(depth), np.float32(geometry.standoff_m), depth)


def shaded_by_its_own_axis(depth, mesh, T, geometry):
    return depth + 1e-4 * T[:, 0, 0, None, None].astype(np.float32)


def beside_by_pixels(self, mesh, T, geometry):
    return ReferenceRenderer.render(self, mesh, T, dataclasses.replace(geometry, cx=geometry.cx + 2))


RENDERER = [
    (renderers.property_any_view, made(ReferenceRenderer, render=transposed)),
    (renderers.property_any_view, made(ReferenceRenderer, render=beside_by_pixels)),
    (renderers.property_any_view, drawing(silhouettes)),
    (renderers.property_any_view, drawing(shaded_by_its_own_axis)),
    (renderers.check_output, drawing(lambda d, *_: d.astype(float))),
    (renderers.check_output, drawing(lambda d, *_: np.nan_to_num(d, posinf=0.0))),
    (renderers.check_sphere, made(ReferenceRenderer, render=off_by_half_a_pixel)),
    (renderers.check_plane, drawing(along_the_ray)),
    (renderers.check_hidden_surfaces, made(ReferenceRenderer, render=without_the_boss)),
    (renderers.check_batch_is_singles, drawing(lambda d, *_: d[::-1].copy())),
    (renderers.check_apart_is_together, then(ReferenceRenderer, "render_apart", lambda d, *_: d + np.float32(1e-4))),
    (renderers.check_mesh_and_poses_untouched, drawing(lambda d, m, T, g: scribbled(d, T))),
    (renderers.check_mesh_and_poses_untouched, drawing(lambda d, m, T, g: scribbled(d, m.vertices_m))),
    (renderers.check_hidden_surfaces, drawing(lambda d, *_: d[:, :, ::-1])),
    (renderers.check_scale, drawing(lambda d, *_: d + np.float32(1e-4))),
    (renderers.check_deterministic, drifting(ReferenceRenderer, "render", lambda d, n: d + np.float32(1e-6 * n))),
    (renderers.check_undercuts, made(HeightmapRenderer, capabilities=DEFAULT)),
]


def sampling(spacing):
    return made(FaceGrid, sample=lambda self, o, g, s: FaceGrid.sample(self, o, g, spacing(s)))


def seeded(seed):
    return made(FaceGrid, random=lambda self, o, g, n, rng: FaceGrid.random(self, o, g, n, np.random.default_rng(seed)))


def as_often_at_each_yaw(T, obj, geometry, count, rng):
    """Draw positions uniformly within the region of each yaw, regardless of its size."""
    R = T[:, :3, :3] @ rotation_about([0, 0, 1], rng.uniform(0, 2 * np.pi, count))
    return make_transform(R, np.column_stack([rng.uniform(*find_centroid_range(obj, R, geometry)), np.zeros(count)]))


def nearer_places(places, *_):
    return dataclasses.replace(places, T_place_object=make_translation([0, 0, 1e-3]) @ places.T_place_object)


def mirrored_patches(places, *_):
    return dataclasses.replace(places, patches=places.patches[:, :, ::-1])


def places_of_one_side(places, *_):
    some = places.T_place_object[:, 2, 2] > 0
    return dataclasses.replace(places, T_place_object=places.T_place_object[some], patches=places.patches[some])


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
    (grids.property_place_origin, few(then(WholeGrid, "places", places_turned_about_the_origin))),
    (grids.property_symmetric_places, few(made(WholeGrid, places=places_without_symmetry))),
    (grids.check_poses_are_rigid, then(FaceGrid, "sample", lambda T, *_: T * np.array([-1.0, 1, 1, 1])[:, None])),
    (grids.check_poses_are_rigid, then(FaceGrid, "random", lambda T, *_: T[1:])),
    (grids.check_spacing, sampling(lambda s: s / 4)),
    (grids.check_denser_grid_has_more_poses, sampling(lambda s: 0.008)),
    (grids.check_poses_reach_contact, then(FaceGrid, "sample", lambda T, *_: make_translation([0.03, 0, 0]) @ T)),
    (grids.check_covers_random_poses, then(FaceGrid, "sample", lambda T, *_: T[T[:, 0, 3] > 0])),
    (grids.check_random_is_uniform_over_the_grid, then(FaceGrid, "random", as_often_at_each_yaw)),
    (grids.check_random_draws, seeded(None)),
    (grids.check_random_draws, seeded(0)),
    (grids.check_random_draws, then(FaceGrid, "random", lambda T, *_: np.repeat(T[:1], len(T), 0))),
    (grids.check_object_untouched, then(FaceGrid, "random", lambda T, o, *_: scribbled(T, o.mesh.vertices_m))),
    (grids.check_scale, sampling(lambda s: s + 1e-3)),
    (grids.check_places_are_as_drawn, then(WholeGrid, "places", nearer_places)),
    (grids.check_places_are_as_drawn, then(WholeGrid, "places", mirrored_patches)),
    (grids.check_places_are_in_random_poses, then(WholeGrid, "places", places_of_one_side)),
    (grids.check_deterministic, drifting(FaceGrid, "sample", lambda T, n: np.roll(T, n, axis=0))),
]


def fixed_threshold(self, depth, press, geometry):
    return PixelEncoder.encode(self, depth, 0.002, geometry)


def unmasked(self, depth, press, geometry):
    return PixelEncoder.encode(self, depth, press, dataclasses.replace(geometry, observed=None))


def raw_pixels(self, depth, press, geometry):
    return (1 - depth / np.float32(press)).reshape(len(depth), -1)


def unmasked_pixels(self, depth, seen, press, geometry):
    embeddings = self.encode(depth, press, geometry)
    return embeddings, np.ones_like(embeddings)


def knows_nothing(pair, depth, seen, *_):
    """Weights of zero if any pixel is unseen."""
    return pair[0], pair[1] * seen.all(axis=(1, 2))[:, None]


LEARNS = Capabilities(follows_press_depth=True, needs_training=True)


def cropped(self, depth, press, geometry):
    """Crops the corner of a large image."""
    rows, columns = encoders.CAMERA.shape
    return PixelEncoder.encode(self, depth[:, :rows, :columns], press, encoders.CAMERA)


ENCODER = [
    (encoders.check_image_size, made(PixelEncoder, encode=cropped)),
    (encoders.property_mirror_image, then(PixelEncoder, "encode", lambda e, *_: np.sort(e, axis=1))),
    (encoders.check_output, then(PixelEncoder, "encode", lambda e, *_: e.astype(float))),
    (encoders.check_output, made(PixelEncoder, encode=lambda self, d, p, g: d)),
    (encoders.check_batch_is_singles, then(PixelEncoder, "encode", lambda e, *_: e - e.mean(axis=0))),
    (encoders.check_shapes_untouched, then(PixelEncoder, "encode", lambda e, d, *_: scribbled(e, d))),
    (encoders.check_distances_order_poses, then(PixelEncoder, "encode", lambda e, *_: 0 * e)),
    (encoders.check_press_depth_marks_no_contact, made(PixelEncoder, encode=fixed_threshold)),
    (encoders.check_light_press_finds_its_pose, made(PixelEncoder, encode=fixed_threshold, capabilities=DEFAULT)),
    (encoders.check_image_size, made(PixelEncoder, encode=raw_pixels)),
    (encoders.check_patches, then(PixelEncoder, "encode_patches", lambda e, *_: 2 * e)),
    (encoders.check_ignores_masked_pixels, made(PixelEncoder, encode=unmasked)),
    (encoders.check_unseen_pixels, made(PixelEncoder, encode_seen=unmasked_pixels)),
    (encoders.check_seen_output, then(PixelEncoder, "encode_seen", lambda pair, *_: pair[0])),
    (encoders.check_seen_output, then(PixelEncoder, "encode_seen", lambda pair, *_: (pair[0], 2 * pair[1]))),
    (encoders.check_seen_output, then(PixelEncoder, "encode_seen", lambda pair, *_: (pair[0], pair[1].astype(float)))),
    (encoders.check_seen_output, then(PixelEncoder, "encode_seen", lambda pair, *_: (pair[0] / pair[1], pair[1]))),
    (encoders.check_seen_output, then(PixelEncoder, "encode_seen", lambda pair, d, *_: scribbled(pair, d))),
    (encoders.check_seen_part_finds_its_pose, then(PixelEncoder, "encode_seen", knows_nothing)),
    (encoders.check_learns_places, made(PixelEncoder, encode_seen=unmasked_pixels, capabilities=LEARNS)),
    (encoders.check_deterministic, drifting(PixelEncoder, "encode", lambda e, n: e + np.float32(1e-3 * n))),
]


def appended(self, bank):
    DenseMatcher.index(self, np.concatenate([getattr(self, "_bank", bank[:0]), bank]))


def masked_queries(self, queries, weights=None):
    return DenseMatcher.scores(self, queries if weights is None else weights * queries)


def refuses_weights(self, queries, weights=None):
    if weights is not None and (weights < 1).any():
        raise ConfigError("this matcher cannot weigh")
    return DenseMatcher.scores(self, queries)


def first_rows_of_weighted(self, queries, weights=None):
    """Compares weighted queries with the first rows only."""
    scores = FaissMatcher.scores(self, queries, weights)
    if weights is not None and (weights < 1).any():
        scores[:, 900:] = -INFINITE
    return scores


def along_the_axes(self, queries):
    return -0.5 * np.abs(queries[:, None] - self._bank[None]).sum(axis=-1)


MATCHER = [
    (matchers.property_any_space, made(DenseMatcher, scores=along_the_axes)),
    (matchers.property_any_space, then(DenseMatcher, "scores", lambda s, _: s - 1e-4 * np.arange(s.shape[1]))),
    (matchers.property_any_space, then(DenseMatcher, "scores", lambda s, _: np.maximum(s, -1))),
    (matchers.check_output, then(DenseMatcher, "scores", lambda s, *_: s.astype(float))),
    (matchers.check_output, then(DenseMatcher, "scores", lambda s, *_: np.where(s < -1, -INFINITE, s))),
    (matchers.check_definition, then(DenseMatcher, "scores", lambda s, *_: 2 * s)),
    (matchers.check_definition, then(DenseMatcher, "scores", lambda s, *_: -s)),
    (matchers.check_definition, then(DenseMatcher, "scores", lambda s, *_: np.sort(s, axis=1))),
    (matchers.check_query_order, then(DenseMatcher, "scores", lambda s, *_: s[::-1])),
    (matchers.check_index_replaces, made(DenseMatcher, index=appended)),
    (matchers.check_weights, made(DenseMatcher, scores=masked_queries)),
    (matchers.check_weights, made(DenseMatcher, scores=lambda self, q, w=None: DenseMatcher.scores(self, q))),
    (matchers.check_weights, made(DenseMatcher, scores=lambda self, q: DenseMatcher.scores(self, q))),
    (matchers.check_weights, made(DenseMatcher, scores=refuses_weights)),
    (matchers.check_weights, made(FaissMatcher, scores=first_rows_of_weighted)),
    (matchers.check_weights, then(DenseMatcher, "scores", lambda s, q, *w: scribbled(s, w[0]) if w else s)),
    (matchers.check_index_replaces, then(DenseMatcher, "scores", lambda s, *_: np.squeeze(s))),
    (matchers.check_bank_and_queries_untouched, then(DenseMatcher, "scores", scribbled)),
    (matchers.check_bank_and_queries_untouched, then(DenseMatcher, "index", scribbled)),
    (matchers.check_deterministic, drifting(DenseMatcher, "scores", lambda s, n: s - np.float32(1e-3 * n))),
]


def moved(result: RefinedPose, x_m: float) -> RefinedPose:
    return dataclasses.replace(result, T_sensor_object=make_translation([x_m, 0, 0]) @ result.T_sensor_object)


def by_all_pixels(self, touch, candidate, scene):
    return moved(NoRefiner.refine(self, touch, candidate, scene), 1e-6 * touch.contact_shape.contact.sum())


def needs_points(self, touch, candidate, scene):
    if touch.contact_shape.contact.sum() < 10:
        raise RuntimeError("singular matrix")
    return NoRefiner.refine(self, touch, candidate, scene)


def full_press_only(self, touch, candidate, scene):
    deep = touch.press_depth_m > 1e-3
    return (IcpRefiner if deep else NoRefiner).refine(self, touch, candidate, scene)


def own_candidate(self, touch, candidate, scene):
    return RefinedPose(candidate.T_sensor_object, 0.0, True, 0)


def scribbled_touch(result, touch, candidate, scene):
    return scribbled(result, touch.contact_shape.depth_m)


def saying(**fields):
    return then(NoRefiner, "refine", lambda result, *_: dataclasses.replace(result, **fields))


def turned_about_the_origin(result, *_):
    """Rotates the object about the origin of its own frame."""
    turn = make_transform(rotation_about([0, 0, 1], 0.02), np.zeros(3))
    return dataclasses.replace(result, T_sensor_object=result.T_sensor_object @ turn)


def needs_a_slope(self, touch, candidate, scene):
    depth = touch.contact_shape.depth_m[touch.contact_shape.contact]
    result = NoRefiner.refine(self, touch, candidate, scene)
    singular = depth.size > 20 and np.ptp(depth) == 0
    return dataclasses.replace(result, T_sensor_object=np.full((4, 4), np.nan)) if singular else result


def reversed_many(self, touch, candidates, scene):
    return NoRefiner.refine_many(self, touch, candidates[::-1], scene)


def needs_one(self, touch, candidates, scene):
    np.stack([candidate.T_sensor_object for candidate in candidates])
    return NoRefiner.refine_many(self, touch, candidates, scene)


def together(self, touch, candidates, scene):
    """Stop all candidates when the first one stops."""
    many = IcpRefiner.refine_many(self, touch, candidates, scene)
    return [dataclasses.replace(result, converged=many[0].converged) for result in many]


def towards_its_own_axis(result, *_):
    return moved(result, 3e-4 * result.T_sensor_object[0, 0])


def reflected(result, *_):
    return dataclasses.replace(result, T_sensor_object=result.T_sensor_object @ MIRROR)


REFINER = [
    (refiners.property_symmetric_copies, then(NoRefiner, "refine", towards_its_own_axis)),
    (refiners.property_mirrored_part, then(NoRefiner, "refine", reflected)),
    (refiners.property_mirrored_part, then(NoRefiner, "refine", lambda r, *_: moved(r, 0.03))),
    (refiners.check_output, saying(contact_iou=2.0)),
    (refiners.check_output, saying(T_sensor_object=-np.eye(4))),
    (refiners.check_truth_stays, then(NoRefiner, "refine", lambda r, *_: moved(r, 2e-4))),
    (refiners.check_touch_and_candidate_untouched, made(NoRefiner, refine=own_candidate)),
    (refiners.check_touch_and_candidate_untouched, then(NoRefiner, "refine", scribbled_touch)),
    (refiners.check_quarter_turn, then(NoRefiner, "refine", lambda r, *_: moved(r, 3e-4))),
    (refiners.check_scale, then(NoRefiner, "refine", lambda r, *_: moved(r, 3e-4))),
    (refiners.check_object_frame, then(NoRefiner, "refine", turned_about_the_origin)),
    (refiners.check_ignores_masked_pixels, made(NoRefiner, refine=by_all_pixels)),
    (refiners.check_degenerate_contact, made(NoRefiner, refine=needs_points)),
    (refiners.check_degenerate_contact, made(NoRefiner, refine=needs_a_slope)),
    (refiners.check_candidate_without_contact, made(NoRefiner, capabilities=DEFAULT)),
    (refiners.check_many_are_one_by_one, made(NoRefiner, refine_many=reversed_many)),
    (refiners.check_many_are_one_by_one, made(NoRefiner, refine_many=needs_one)),
    (refiners.check_many_are_one_by_one, made(IcpRefiner, refine_many=together)),
    (refiners.check_candidate_without_contact, saying(contact_iou=1.0)),
    (refiners.check_deterministic, drifting(NoRefiner, "refine", lambda r, n: moved(r, 1e-9 * n))),
    (refiners.check_offsets_shrink, made(NoRefiner, capabilities=DEFAULT)),
    (refiners.check_offsets_shrink, made(IcpRefiner, refine=full_press_only)),
]


def with_log_p(change):
    def fuse(self, posteriors, T_base_sensor, prior=None):
        first = posteriors[0]
        weights = 0.0 if prior is None else prior(first.grid.T_sensor_object)
        return PosePosterior(first.grid, change(first.log_p, weights))

    return fuse


def without_bound(self, posteriors, T_base_sensor, prior=None):
    """Uses the nearest pose of the second touch's grid at any distance."""
    first, second = posteriors
    T = np.linalg.inv(T_base_sensor[1]) @ T_base_sensor[0] @ first.grid.T_sensor_object
    return PosePosterior(first.grid, first.log_p + second.log_p[second.grid.nearest(T)[1]])


def from_the_base(self, posteriors, T_base_sensor, prior=None):
    """Prefers poses near the base."""
    gone_m = (T_base_sensor[0] @ posteriors[0].grid.T_sensor_object)[:, 0, 3]
    return PosePosterior(posteriors[0].grid, posteriors[0].log_p - gone_m)


def in_sensor_frames(self, posteriors, T_base_sensor, prior=None):
    """Reads the second touch at the first one's poses, without transforming them."""
    first, second = posteriors
    return PosePosterior(first.grid, first.log_p + second.log_p[second.grid.nearest(first.grid.T_sensor_object)[1]])


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
    (fusers.property_symmetric_copies, made(ProductFuser, fuse=without_symmetry)),
    (fusers.check_one_touch, made(ProductFuser, fuse=with_log_p(lambda p, w: 0.5 * p + w))),
    (fusers.check_prior_multiplies, made(ProductFuser, fuse=with_log_p(lambda p, w: p * w))),
    (fusers.check_prior_multiplies, made(ProductFuser, fuse=with_log_p(lambda p, w: p + 2 * w))),
    (fusers.check_prior_multiplies, made(ProductFuser, fuse=with_log_p(lambda p, w: p + np.maximum(w, -5)))),
    (fusers.check_impossible_prior, made(ProductFuser, fuse=with_log_p(lambda p, w: p + np.nan_to_num(w)))),
    (fusers.check_order, made(ProductFuser, fuse=lambda self, posteriors, T, prior=None: posteriors[0])),
    (fusers.check_sensor_poses, made(ProductFuser, fuse=in_sensor_frames)),
    (fusers.check_sensor_poses, made(KinematicFuser, capabilities=DEFAULT)),
    (fusers.check_one_touch, made(ProductFuser, capabilities=Capabilities(contact_only=True))),
    (fusers.check_no_contact_is_dropped, made(ProductFuser, fuse=without_bound)),
    (fusers.check_no_common_pose, made(ProductFuser, fuse=without_bound)),
    (fusers.check_base_frame, made(ProductFuser, fuse=from_the_base)),
    (fusers.check_posteriors_untouched, then(ProductFuser, "fuse", lambda r, p, *_: scribbled(r, p[0].log_p))),
    (fusers.check_deterministic, drifting(ProductFuser, "fuse", lambda r, n: PosePosterior(r.grid, r.log_p * (1 + n)))),
]


BROKEN = [*COMMON, *SENSOR, *RENDERER, *GRID, *ENCODER, *MATCHER, *REFINER, *FUSER]


def with_motion(change):
    """ICP whose motion M = T @ inv(candidate) is changed to change(M, candidate)."""

    def refine(self, touch, candidate, scene):
        result, C = IcpRefiner().refine(touch, candidate, scene), candidate.T_sensor_object
        return dataclasses.replace(result, T_sensor_object=change(result.T_sensor_object @ np.linalg.inv(C), C))

    return made(NoRefiner, refine=refine, capabilities=DEFAULT)


def with_pose(change):
    return then(NoRefiner, "refine", lambda r, *_: dataclasses.replace(r, T_sensor_object=change(r.T_sensor_object)))


def reversed_turn(M):
    return make_transform(M[:3, :3].T, M[:3, 3])


def seen_by(change):
    """A renderer that draws with another camera or other poses: change(T, geometry) returns both."""

    def render(self, mesh, T, geometry):
        T, geometry = change(T, geometry)
        return ReferenceRenderer.render(self, mesh, T, geometry)

    return made(ReferenceRenderer, render=render)


def shown(change):
    return drawing(lambda depth, mesh, T, geometry: change(depth, geometry))


def read_as(change):
    return then(
        GelSlim, "contact_shape", lambda s, _: ContactShape(change(s.depth_m).astype(np.float32), s.press_depth_m)
    )


def scored(change):
    def scores(self, queries, weights=None):
        return change(self._bank, queries, np.ones_like(queries) if weights is None else weights).astype(np.float32)

    return made(DenseMatcher, scores=scores)


def squares(bank, queries, weights):
    return np.einsum("md,mnd->mn", weights, (queries[:, None] - bank[None]) ** 2)


def in_mm(T, *_):
    return make_transform(T[:, :3, :3], 1e3 * T[:, :3, 3])


def without_sensor_poses(self, posteriors, T_base_sensor, prior=None):
    return ProductFuser.fuse(self, posteriors, [np.eye(4)] * len(posteriors), prior)


def with_prior(change):
    def fuse(self, posteriors, T_base_sensor, prior=None):
        changed = None if prior is None else (lambda poses: change(prior(poses), len(posteriors)))
        return ProductFuser.fuse(self, posteriors, T_base_sensor, changed)

    return made(ProductFuser, fuse=fuse)


# Mistakes that authors made or may make, and words of the cause that the check must name.
CAUSES = [
    (refiners.check_offsets_shrink, with_motion(lambda M, C: reversed_turn(M) @ C), "turns the wrong way"),
    (refiners.check_offsets_shrink, with_motion(lambda M, C: np.linalg.inv(M) @ C), "is inverted"),
    (refiners.check_quarter_turn, with_motion(lambda M, C: C @ M), "on the object's side"),
    (refiners.check_offsets_shrink, with_motion(lambda M, C: C.copy()), "refines=False"),
    (refiners.check_truth_stays, with_pose(reversed_turn), "the rotation is transposed"),
    (refiners.check_truth_stays, with_pose(np.linalg.inv), "the pose is inverted"),
    (refiners.check_truth_stays, with_pose(np.transpose), "row vectors"),
    (refiners.check_truth_stays, with_pose(lambda T: make_transform(T[:3, :3], 1e3 * T[:3, 3])), "millimetres"),
    (renderers.check_hidden_surfaces, made(ReferenceRenderer, render=transposed), "transposed"),
    (renderers.check_plane, seen_by(lambda T, g: (np.linalg.inv(T), g)), "T_sensor_object is inverted"),
    (renderers.check_plane, seen_by(lambda T, g: (T, dataclasses.replace(g, fy=g.fx))), "fx is used for fy"),
    (
        renderers.check_sphere,
        seen_by(lambda T, g: (T, dataclasses.replace(g, cx=g.cx + 0.5, cy=g.cy + 0.5))),
        "half a pixel",
    ),
    (renderers.check_undercuts, shown(lambda d, g: d * np.float32(1e3)), "millimetres"),
    (renderers.check_undercuts, shown(lambda d, g: d[:, :, ::-1]), "columns are in the opposite order"),
    (renderers.check_undercuts, made(HeightmapRenderer, capabilities=DEFAULT), "exact_undercuts=False"),
    (renderers.check_sphere, shown(lambda d, g: d - np.float32(g.standoff_m)), "add standoff_m"),
    (renderers.check_output, shown(lambda d, g: np.where(np.isinf(d), np.float32(0), d)), "have depth 0"),
    (sensors.check_depths_are_kept, read_as(lambda d: 1e3 * d), "millimetres"),
    (sensors.check_depths_are_kept, read_as(lambda d: d[:, ::-1]), "columns are in the opposite order"),
    (sensors.check_depths_are_kept, read_as(lambda d: d[::-1]), "rows are in the opposite order"),
    (sensors.check_depths_are_kept, read_as(lambda d: d.max() - d), "0 is the deepest point"),
    (matchers.check_definition, scored(lambda b, q, w: -squares(b, q, w)), "factor 1/2"),
    (matchers.check_index_replaces, scored(lambda b, q, w: q @ b.T), "scalar product"),
    (matchers.check_weights, scored(lambda b, q, w: -0.5 * squares(b, q, np.ones_like(w))), "weights are ignored"),
    (matchers.check_weights, scored(lambda b, q, w: -0.5 * squares(b, w * q, np.ones_like(w))), "only the queries"),
    (encoders.check_patches, made(PixelEncoder, encode=fixed_threshold), "inherited"),
    (encoders.check_press_depth_marks_no_contact, made(PixelEncoder, encode=fixed_threshold), "by a fixed depth"),
    (grids.check_poses_reach_contact, then(FaceGrid, "sample", in_mm), "millimetres"),
    (grids.check_denser_grid_has_more_poses, sampling(lambda s: 0.008), "spacing_m is not used"),
    (fusers.check_prior_multiplies, with_prior(lambda w, touches: 0 * np.nan_to_num(w)), "the prior is ignored"),
    (fusers.check_prior_multiplies, with_prior(lambda w, touches: touches * w), "added twice"),
    (fusers.check_sensor_poses, made(ProductFuser, fuse=without_sensor_poses), "T_base_sensor is ignored"),
]
