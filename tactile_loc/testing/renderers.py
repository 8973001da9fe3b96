"""Checks for renderers: depths must follow from the geometry, and every view must look like the reference."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats, Poses, invert, make_transform, rotation_about
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.contact import bring_to_contact
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import compute_contact_depth
from tactile_loc.slots.renderer import Renderer
from tactile_loc.testing.contract import (
    Cause,
    ContractError,
    Untouched,
    check,
    name_cause,
    require,
    require_array,
    require_close,
    require_equal,
)
from tactile_loc.testing.problems import (
    CAMERAS,
    LOPSIDED_CAMERAS,
    ReferenceRenderer,
    copy_mesh,
    make_ball,
    make_overhang,
    make_planar_pose,
    make_plate,
    make_prism,
    make_stepped_block,
    mirror_mesh,
    scale_mesh,
    scale_sensor,
    transform_mesh,
)
from tactile_loc.testing.properties import Place, RigidMotion, hold, motions, one_of, places, whole

TOLERANCE_M = 3e-5  # allowed error of a pixel; half a cell of a height map, on a slope
MEAN_TOLERANCE_M = 8e-6
Depths = NDArray[np.floating]

STRAY = 0.02  # share of pixels that may differ, because their centres lie at an edge
PARTS: dict[str, Callable[[], TriangleMesh]] = {
    "block": make_stepped_block,
    "mirrored block": lambda: mirror_mesh(make_stepped_block()),
    "prism": lambda: make_prism().mesh,
}


@check("renderer")
def check_output(renderer: Renderer) -> None:
    """`render` returns (N, H, W) float32 without NaN for any N. Pixels without surface are beyond the contact band."""
    for camera in LOPSIDED_CAMERAS.values():
        T = _bring_block(camera)
        for count in (1, 3, 0):
            try:
                depth = renderer.render(make_stepped_block(), T[:count], camera)
            except Exception as error:
                if count:
                    raise
                raise ContractError(
                    f"no poses must give an empty array, not {type(error).__name__}: {error}"
                ) from error
            require_array(depth, (count, *camera.shape), np.float32, f"the depths of {count} poses")
            require(not np.isnan(depth).any(), "a depth must not be NaN; a ray without surface has depth inf")
        drawn = renderer.render(make_stepped_block(), T, camera)
        misses = np.isinf(ReferenceRenderer().render(make_stepped_block(), T, camera))
        near = float((drawn[misses] <= camera.standoff_m + camera.max_depth_m).mean())
        require(
            near < STRAY,
            f"pixels without surface must be deeper than standoff + max_depth; {100 * near:.0f} % of them are not",
            partial(_name_mistake, renderer, camera),
        )


@check("renderer")
def check_sphere(renderer: Renderer) -> None:
    """A sphere has its analytic depth at pixel centres, within the contact band."""
    for camera in LOPSIDED_CAMERAS.values():
        centre = np.array([0.0013, -0.0021, camera.standoff_m + 0.008])
        T, truth = make_transform(np.eye(3), centre), _intersect_sphere(camera, centre, 0.008)
        depth = _draw(renderer, make_ball(), T[None], camera)[0]
        sentence = "a sphere must have its analytic depth"
        _compare(depth, truth, camera, sentence, partial(_name_mistake, renderer, camera))


@check("renderer")
def check_plane(renderer: Renderer) -> None:
    """A tilted plane has its analytic depth."""
    for camera in LOPSIDED_CAMERAS.values():
        T = make_transform(rotation_about([1, 0.4, 0], 0.08), [0.001, 0.002, camera.standoff_m + 0.001])
        depth = _draw(renderer, make_plate(), T[None], camera)[0]
        origin, direction = _make_rays(camera)
        truth = ((T[:3, 3] - origin) @ T[:3, 2]) / (direction @ T[:3, 2])
        sentence = "a tilted plane must have its analytic depth"
        _compare(depth, truth, camera, sentence, partial(_name_mistake, renderer, camera))


@check("renderer")
def check_hidden_surfaces(renderer: Renderer) -> None:
    """A pixel shows the nearest surface along its ray, so the block looks like that of the reference renderer."""
    for camera in LOPSIDED_CAMERAS.values():
        _require_drawn(
            renderer,
            make_stepped_block(),
            _bring_block(camera),
            camera,
            "each pixel must show the depth of the nearest surface",
        )


@check("renderer")
def check_batch_is_singles(renderer: Renderer) -> None:
    """Rendering poses together gives the same as rendering them one by one, in the same order."""
    camera = LOPSIDED_CAMERAS["pinhole"]
    T = _bring_block(camera)
    together = renderer.render(make_stepped_block(), T, camera)
    singly = np.concatenate([renderer.render(make_stepped_block(), t[None], camera) for t in T])
    _same(together, singly, camera, "a batch must be the same as its poses one by one")


@check("renderer")
def check_apart_is_together(renderer: Renderer) -> None:
    """`render_apart`, which is for poses with different rotations, draws the same as `render`."""
    for camera in LOPSIDED_CAMERAS.values():
        T = _bring_block(camera)
        apart, together = (draw(make_stepped_block(), T, camera) for draw in (renderer.render_apart, renderer.render))
        _same(apart, together, camera, "`render_apart` must draw what `render` draws")


@check("renderer")
def check_mesh_and_poses_untouched(renderer: Renderer) -> None:
    """The mesh and the poses are not changed."""
    camera, mesh = CAMERAS["orthographic"], copy_mesh(make_stepped_block())
    T = _bring_block(camera)
    before = Untouched(vertices_m=mesh.vertices_m, faces=mesh.faces, T_sensor_object=T)
    renderer.render(mesh, T, camera)
    before.require()


@check("renderer")
def check_scale(renderer: Renderer) -> None:
    """Twice the object on twice the sensor has twice the depths, because no length is built in."""
    for camera in LOPSIDED_CAMERAS.values():
        poses = _bring_block(camera)
        double = poses.copy()
        double[:, :3, 3] *= 2
        small = renderer.render(make_stepped_block(), poses, camera)
        large = renderer.render(scale_mesh(make_stepped_block(), 2.0), double, scale_sensor(camera, 2.0))
        often = "; often, a length is fixed in metres, such as a near or far plane, or another mesh is kept"
        _same(large / 2, small, camera, "depths must scale with the object and the sensor", cause=often)


@check("renderer", "deterministic")
def check_deterministic(renderer: Renderer) -> None:
    """The same poses give exactly the same depths."""
    camera = LOPSIDED_CAMERAS["pinhole"]
    T = _bring_block(camera)
    first, again = (renderer.render(copy_mesh(make_stepped_block()), T.copy(), camera) for _ in range(2))
    require_equal(first, again, "the same poses must give the same depths")


@check("renderer", "exact_undercuts")
def check_undercuts(renderer: Renderer) -> None:
    """From beside, a pinhole camera sees the surface behind an overhang."""
    camera = SensorGeometry("pinhole", 64, 64, 32.0, 32.0, 32.0, 32.0, 0.010, 0.002)  # its field of view is 90 degrees
    T = bring_to_contact(make_overhang(), make_planar_pose(0.0, 0.0, 0.0)[None], camera)[0]
    depth, truth = (_draw(one, make_overhang(), T, camera) for one in (renderer, ReferenceRenderer()))
    often = "a height is kept for each cell, which sees no undercuts; then declare exact_undercuts=False"
    sentence = "the surface behind an overhang must be seen"
    _same(depth, truth, camera, sentence, 0.01, partial(_name_mistake, renderer, LOPSIDED_CAMERAS["pinhole"], often))


@check("renderer", "property")
def property_any_view(renderer: Renderer) -> None:
    """A part, in any frame of the object, at any pose and in any image size, looks as the reference renderer draws it.

    So neither the object's frame nor the choice among symmetric poses matters, and a mirrored part looks mirrored.
    """

    def claim(part: str, motion: RigidMotion, place: Place, width_px: int, camera_name: str) -> None:
        camera = LOPSIDED_CAMERAS[camera_name].resize(width_px, width_px - 20)
        mesh = transform_mesh(PARTS[part](), motion.T)
        T = bring_to_contact(mesh, place.pose[None] @ invert(motion.T), camera)[0]
        _require_drawn(renderer, mesh, T, camera, "a part must look the same in any frame, pose and image size")

    drawn = {"motion": motions(), "place": places(most_tilt_deg=10), "width_px": whole(50, 120)}
    hold(claim, examples=8, part=one_of(list(PARTS)), camera_name=one_of(list(LOPSIDED_CAMERAS)), **drawn)


def _bring_block(camera: SensorGeometry) -> Poses:
    """Return contact poses (3, 4, 4) of the block: two with the same rotation, and one tilted pose."""
    tilted = make_planar_pose(-0.001, 0.0015, 2.0)
    tilted[:3, :3] = rotation_about([1, 0.5, 0], 0.12) @ tilted[:3, :3]
    flat = make_planar_pose(0.0006, -0.0011, 0.3), make_planar_pose(-0.0023, 0.0004, 0.3)
    return bring_to_contact(make_stepped_block(), np.stack([*flat, tilted]), camera)[0]


def _make_rays(camera: SensorGeometry) -> tuple[Floats, Floats]:
    """Return origins and directions (H, W, 3) of the rays through pixel centres. Each direction has z = 1."""
    x, y = np.meshgrid(*camera.pixel_slopes)
    zero, one = np.zeros_like(x), np.ones_like(x)
    if camera.is_pinhole:
        return np.stack([zero, zero, zero], -1), np.stack([x, y, one], -1)
    return np.stack([x, y, zero], -1), np.stack([zero, zero, one], -1)


def _intersect_sphere(camera: SensorGeometry, centre_m: Floats, radius_m: float) -> Floats:
    origin, direction = _make_rays(camera)
    a, b = (direction**2).sum(-1), (direction * (centre_m - origin)).sum(-1)
    root = b**2 - a * (((centre_m - origin) ** 2).sum(-1) - radius_m**2)
    return np.where(root >= 0, (b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)


def _compare(depth: Float32, truth: Floats, camera: SensorGeometry, sentence: str, cause: Cause) -> None:
    """Compare a smooth surface's depths (H, W) with the true depths, inside and outside the contact band."""
    end = camera.standoff_m + camera.max_depth_m
    inside = (truth >= camera.standoff_m) & (truth < end - TOLERANCE_M)
    outside = truth > end + TOLERANCE_M
    require_close(depth[inside], truth[inside], TOLERANCE_M, f"{sentence}, in metres", cause)
    mean = float(np.abs(depth[inside] - truth[inside]).mean())
    near = mean <= MEAN_TOLERANCE_M
    require(near, f"{sentence}; the mean difference is {mean:.2g} m, allowed {MEAN_TOLERANCE_M:.2g} m", cause)
    beyond = not (depth[outside] < end).any()
    require(beyond, f"{sentence}; outside the contact band it must be deeper than the band", cause)


def _require_drawn(renderer: Renderer, mesh: TriangleMesh, T: Poses, camera: SensorGeometry, sentence: str) -> None:
    """Raise ContractError unless poses (N, 4, 4) look as the reference renderer draws them."""
    depth, truth = (_draw(one, mesh, T, camera) for one in (renderer, ReferenceRenderer()))
    _same(depth, truth, camera, sentence, cause=partial(_name_mistake, renderer, camera))


def _draw(renderer: Renderer, mesh: TriangleMesh, T: Poses, camera: SensorGeometry) -> Float32:
    """Return the depths (N, H, W), metres, of poses (N, 4, 4). Raises ContractError if they have another form."""
    depth = renderer.render(mesh, T, camera)
    form, wanted = np.shape(depth), (len(T), *camera.shape)
    require(form == wanted, f"the depths of {len(T)} poses must have shape {wanted}, not {form}")
    return depth


def _same(
    depth: Depths, truth: Depths, camera: SensorGeometry, sentence: str, stray: float = STRAY, cause: Cause = ""
) -> None:
    """Compare the contact depths (N, H, W) of two pictures. A share `stray` of the pixels may differ."""
    require(depth.shape == truth.shape, f"{sentence}; the shapes are {depth.shape} and {truth.shape}")
    differ = _count_different(depth, truth, camera)
    require(differ <= stray, f"{sentence}; {100 * differ:.1f} % of the pixels differ, allowed {100 * stray:g} %", cause)


def _count_different(depth: Depths, truth: Depths, camera: SensorGeometry) -> float:
    """Return the share of pixels with different contact depths."""
    a, b = (compute_contact_depth(d, camera, camera.max_depth_m) for d in (depth, truth))
    return float((np.abs(a - b) > TOLERANCE_M).mean())


def _name_mistake(renderer: Renderer, camera: SensorGeometry, often: str = "") -> str:
    """Name the mistake with which the reference renderer draws the block as the renderer does.

    If the block is drawn rightly, name what is `often` the cause.
    """
    T, mesh = _bring_block(camera), make_stepped_block()
    depth = _draw(renderer, mesh, T, camera)

    def draw(poses: Poses = T, **changes: Any) -> Depths:
        return ReferenceRenderer().render(mesh, poses, dataclasses.replace(camera, **changes))

    def shift(by_px: float) -> Depths:
        return draw(cx=camera.cx + by_px, cy=camera.cy + by_px)

    truth = draw()
    if _count_different(depth, truth, camera) <= STRAY:
        return f"; often, {often}" if often else ""
    x, y = np.meshgrid(*camera.pixel_slopes)
    k = camera.standoff_m if camera.is_pinhole else 1.0
    flipped = make_transform(T[:, :3, :3].swapaxes(1, 2), T[:, :3, 3])
    alike: dict[str, Callable[[], tuple[Depths, Depths]]] = {
        "the rotation of T_sensor_object is transposed": lambda: (depth, draw(flipped)),
        "T_sensor_object is inverted; it maps the object's points to the camera": lambda: (depth, draw(invert(T))),
        "all poses are drawn as the first one": lambda: (depth, np.repeat(truth[:1], len(T), 0)),
        "depths are in millimetres": lambda: (depth / np.float32(1e3), truth),
        "depths are measured from the gel; add standoff_m": lambda: (depth + np.float32(camera.standoff_m), truth),
        "rows are in the opposite order; +y points down": lambda: (depth[:, ::-1], truth),
        "columns are in the opposite order; +x points right": lambda: (depth[:, :, ::-1], truth),
        "pixels without surface have depth 0; set them to inf": lambda: (np.where(depth > 0, depth, np.inf), truth),
        "the image is turned by half a turn": lambda: (depth[:, ::-1, ::-1], truth),
        "depths are distances along rays; return z": lambda: (depth, truth * np.sqrt(1 + x**2 + y**2)),
        "cx and cy are not used": lambda: (depth, draw(cx=camera.width_px / 2, cy=camera.height_px / 2)),
        "fx is used for fy": lambda: (depth, draw(fy=camera.fx)),
        "the pinhole is drawn with parallel rays": lambda: (
            depth,
            draw(camera="orthographic", fx=camera.fx / k, fy=camera.fy / k),
        ),
        "rays are half a pixel too far left and up; pixel centres lie at half integers": lambda: (depth, shift(0.5)),
        "rays are half a pixel too far right and down; pixel centres lie at half integers": lambda: (
            depth,
            shift(-0.5),
        ),
    }

    def explains(pair: Callable[[], tuple[Depths, Depths]]) -> bool:
        shown, wrong = pair()
        contact = compute_contact_depth(wrong, camera, camera.max_depth_m) < camera.max_depth_m
        return bool(contact.any()) and _count_different(shown, wrong, camera) <= STRAY

    return name_cause(alike, explains)
