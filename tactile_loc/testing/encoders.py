"""Checks for encoders: similar poses must have similar embeddings, at any press depth and image size."""

import dataclasses

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, make_translation
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.places.places import CAMERA as PATCH_CAMERA
from tactile_loc.core.places.places import PATCH_PX, cut_patches
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import compute_contact_depth
from tactile_loc.slots.encoder import Encoder
from tactile_loc.testing.contract import (
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
    LOPSIDED_CAMERAS,
    ReferenceRenderer,
    make_block_scene,
    make_contact_poses,
    make_place_training_problem,
    make_stepped_block,
    mirror_mesh,
)
from tactile_loc.testing.properties import Place, hold, places

CAMERA = LOPSIDED_CAMERAS["orthographic"]
PRESS_M = CAMERA.max_depth_m
LIGHT_M = 0.3 * PRESS_M  # only the block's features touch
BESIDE_M = (0.0002, 0.0002, 0.0)


@check("encoder")
def check_output(encoder: Encoder) -> None:
    """`encode` returns finite (N, D) float32 with the same D for any N, also for a shape without contact."""
    shapes = _draw_shapes()
    vectors = _encode(encoder, shapes, PRESS_M, CAMERA)
    require(vectors.dtype == np.float32, f"embeddings are float32, not {vectors.dtype}")
    for what, some in (("no shape", shapes[:0]), ("a shape without contact", np.full_like(shapes[:1], PRESS_M))):
        try:
            other = _encode(encoder, some, PRESS_M, CAMERA)
        except ContractError:
            raise
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
            raise ContractError(f"{what} must have embeddings ({len(some)}, D), not {problem}") from error
        same = other.shape == (len(some), vectors.shape[1])
        require(same, f"{what} must be encoded as ({len(some)}, {vectors.shape[1]}), not {other.shape}")
        often = "; often, it is divided by its length, which is 0"
        require(np.isfinite(other).all(), f"{what} must have a finite embedding", often)
    require(np.isfinite(vectors).all(), "embeddings must be finite")


@check("encoder")
def check_batch_is_singles(encoder: Encoder) -> None:
    """Shapes that are encoded together get the same embeddings as one by one."""
    shapes = _draw_shapes()
    together = _encode(encoder, shapes, PRESS_M, CAMERA)
    singly = np.concatenate([_encode(encoder, s[None], PRESS_M, CAMERA) for s in shapes])
    often = "; often, embeddings are normalised over the batch; normalise each one alone"
    _require_alike(together, singly, together, "a batch must be encoded as its shapes one by one", often)


@check("encoder")
def check_shapes_untouched(encoder: Encoder) -> None:
    """The contact shapes are not changed."""
    shapes = _draw_shapes()
    before = Untouched(depth_m=shapes)
    _encode(encoder, shapes, PRESS_M, CAMERA)
    before.require()


@check("encoder")
def check_distances_order_poses(encoder: Encoder) -> None:
    """A shape is nearest to itself, and a shape 0.5 mm away is nearer than clearly different poses."""
    poses = make_contact_poses(make_block_scene())
    here, moved = _render(poses), _render(make_translation([0.0004, 0.0003, 0.0]) @ poses)
    bank = _encode(encoder, here, PRESS_M, CAMERA)
    _require_found(_encode(encoder, here.copy(), PRESS_M, CAMERA), bank, "every shape must be nearest to itself")
    _require_found(
        _encode(encoder, moved, PRESS_M, CAMERA), bank, "a shape 0.5 mm away must be nearer than other poses"
    )


@check("encoder")
def check_press_depth_marks_no_contact(encoder: Encoder) -> None:
    """A pixel at the press depth is not in contact, so a flat imprint looks the same at any press depth."""
    imprint = np.stack([s < PRESS_M for s in _draw_shapes()])
    light, deep = (np.where(imprint, np.float32(0), np.float32(p)) for p in (0.6 * PRESS_M, PRESS_M))
    bank, queries = _encode(encoder, deep, PRESS_M, CAMERA), _encode(encoder, light, 0.6 * PRESS_M, CAMERA)
    _require_found(
        queries,
        bank,
        "pixels at the press depth have no contact: a flat imprint must look the same at 60 % and at full press",
        "contact is found by a fixed depth, such as geometry.max_depth_m, instead of press_depth_m",
    )


@check("encoder")
def check_light_press_finds_its_pose(encoder: Encoder) -> None:
    """A light press finds its pose in the bank.

    The bank is cut at the same press depth if the encoder declares follows_press_depth, else at the maximal depth.
    """
    light = 0.75 * PRESS_M
    press = light if encoder.capabilities.follows_press_depth else PRESS_M
    bank = _encode(encoder, np.minimum(_draw_shapes(), np.float32(press)), press, CAMERA)
    queries = _encode(encoder, np.minimum(_draw_shapes(), np.float32(light)), light, CAMERA)
    often = "contact is found by a fixed depth, or follows_press_depth=True is not declared"
    _require_found(queries, bank, "a light press must be nearest to its own pose", often)


@check("encoder")
def check_image_size(encoder: Encoder) -> None:
    """Shapes in other image sizes of the same sensor have embeddings of the same length, and find their poses."""
    bank = _encode(encoder, _draw_shapes(), PRESS_M, CAMERA)
    for times in (2, 3):
        fine = CAMERA.resize(times * CAMERA.width_px, times * CAMERA.height_px)
        queries = _encode(encoder, _draw_shapes(fine), PRESS_M, fine)
        same = queries.shape == bank.shape
        require(same, f"D must not depend on the image size, but shapes are {queries.shape} and {bank.shape}")
        _require_found(queries, bank, f"an image of {times} times the size must find its pose in the bank")


@check("encoder")
def check_patches(encoder: Encoder) -> None:
    """`encode_patches` gives the embeddings that `encode` gives for the contact depths of places' patches."""
    patches = np.random.default_rng(0).integers(0, 256, (6, PATCH_PX, PATCH_PX)).astype(np.uint8)
    for press_m in (LIGHT_M, PRESS_M):
        expected = _encode(encoder, cut_patches(patches, press_m), press_m, PATCH_CAMERA)
        found = encoder.encode_patches(patches.copy(), press_m)
        require_array(found, expected.shape, np.float32, "encode_patches")
        cause = _name_inherited(encoder, "encode_patches")
        require_close(found, expected, 1e-4 * _spread(expected), "encode_patches must agree with encode", cause)


@check("encoder")
def check_ignores_masked_pixels(encoder: Encoder) -> None:
    """Unobserved pixels change nothing."""
    observed = np.ones(CAMERA.shape, bool)
    observed[:, : CAMERA.width_px // 4] = False
    masked = dataclasses.replace(CAMERA, observed=observed)
    shapes = _draw_shapes()
    garbage = np.where(observed, shapes, np.float32(0.1 * PRESS_M))
    a, b = (_encode(encoder, s, PRESS_M, masked) for s in (shapes, garbage))
    require_close(a, b, 1e-4 * _spread(a), "pixels outside geometry.observed_mask must change nothing")


@check("encoder")
def check_unseen_pixels(encoder: Encoder) -> None:
    """Unseen pixels change nothing, and fully seen shapes have the embeddings of `encode` and weights of one."""
    shapes = _draw_shapes()
    weights = _require_seen_as_plain(encoder, shapes, PRESS_M, CAMERA)
    require_close(weights, np.ones_like(weights), 1e-6, "fully seen shapes must have weights of one")
    ones, twos = _require_unseen_ignored(encoder, shapes, _mask_left(shapes, 6), 0.3 * PRESS_M, PRESS_M, CAMERA)
    require_close(ones, twos, 1e-6, "weights must depend on the seen pixels only")


@check("encoder")
def check_seen_output(encoder: Encoder) -> None:
    """`encode_seen` returns embeddings and weights of the same shape, weights from 0 to 1, and changes no input."""
    shapes = _draw_shapes()
    form = _encode(encoder, shapes, PRESS_M, CAMERA).shape
    for seen in (_mask_left(shapes, 6), np.zeros(shapes.shape, bool)):
        before = Untouched(depth_m=shapes, seen=seen)
        answer = encoder.encode_seen(shapes, seen, PRESS_M, CAMERA)
        before.require()
        pair = isinstance(answer, tuple) and len(answer) == 2
        require(pair, "encode_seen must return two arrays, embeddings and their weights")
        for what, array in zip(("the embeddings", "the weights"), answer, strict=True):
            require_array(array, form, np.float32, f"{what} of partly seen shapes")
            require(np.isfinite(array).all(), f"{what} of partly seen shapes must be finite")
        require((answer[1] >= 0).all() and (answer[1] <= 1).all(), "weights must be from 0 (unknown) to 1 (known)")


@check("encoder")
def check_seen_part_finds_its_pose(encoder: Encoder) -> None:
    """A partly seen shape, such as a touch at the sensor's edge, has its best weighted score at its own pose."""
    shapes = _draw_shapes()
    bank = _encode(encoder, shapes, PRESS_M, CAMERA)
    queries, weights = encoder.encode_seen(shapes, _mask_left(shapes, 6), PRESS_M, CAMERA)
    found = (weights[:, None] * (queries[:, None] - bank[None]) ** 2).sum(axis=-1).argmin(axis=1)
    _require_order(found, "a partly seen shape must find its own pose")


@check("encoder", "deterministic")
def check_deterministic(encoder: Encoder) -> None:
    """The same shapes have exactly the same embeddings."""
    first, again = (_encode(encoder, _draw_shapes(), PRESS_M, CAMERA) for _ in range(2))
    require_equal(first, again, "the same shapes must have the same embeddings")


@check("encoder", "needs_training")
def check_learns_places(encoder: Encoder) -> None:
    """An encoder that was trained on the places of a whole object embeds partly seen places."""
    problem, learner = make_place_training_problem(), type(encoder)(encoder.options)  # the given encoder is unchanged
    learner.fit(problem)
    press_m = float(problem.key_presses_m[-1])
    keys = np.concatenate(list(problem.clean_keys(press_m)))[:8]
    _require_seen_as_plain(learner, keys, press_m, problem.geometry)
    _require_unseen_ignored(learner, keys, _mask_left(keys, 2), 0.5 * press_m, press_m, problem.geometry)


@check("encoder", "property")
def property_mirror_image(encoder: Encoder) -> None:
    """A light touch is nearer to a touch of the same part, 0.3 mm away, than to its mirror image at the same pose.

    At a light press, only the block's features touch. A full press is not tested, because an encoder may use outlines,
    and the outline of the whole block is its own mirror image.
    """

    def claim(place: Place) -> None:
        poses = place.pose @ make_contact_poses(make_block_scene(), count=4)
        here, beside = (_encode_light(encoder, _render(T)) for T in (poses, make_translation(BESIDE_M) @ poses))
        image = _encode_light(encoder, _render(poses, mesh=mirror_mesh(make_stepped_block())))
        near, far = (np.linalg.norm(other - here, axis=1) for other in (beside, image))
        require(
            (near < far).all(),
            "a part must be nearer to itself, 0.3 mm away, than to its mirror image; "
            f"distances are up to {(near / np.maximum(far, 1e-12)).max():.2f} times as large",
            name_cause({"both have the same embedding": far.max() == 0}),
        )

    hold(claim, examples=3, place=places(most_tenths_mm=15))


def _encode_light(encoder: Encoder, depth_m: Float32) -> Float32:
    """Return embeddings (N, D) of shapes (N, H, W), metres, cut at a light press."""
    return _encode(encoder, np.minimum(depth_m, np.float32(LIGHT_M)), LIGHT_M, CAMERA)


def _encode(encoder: Encoder, shapes: Float32, press_m: float, camera: SensorGeometry) -> Float32:
    """Return the embeddings (N, D) of shapes (N, H, W), metres. Raises ContractError if they have another form."""
    vectors = encoder.encode(shapes, press_m, camera)
    form = isinstance(vectors, np.ndarray) and vectors.ndim == 2 and len(vectors) == len(shapes)
    shown = vectors.shape if isinstance(vectors, np.ndarray) else type(vectors).__name__
    require(form, f"the embeddings of {len(shapes)} shapes must be an array ({len(shapes)}, D), not {shown}")
    return vectors


def _draw_shapes(camera: SensorGeometry = CAMERA) -> Float32:
    return _render(make_contact_poses(make_block_scene()), camera)


def _render(poses: np.ndarray, camera: SensorGeometry = CAMERA, mesh: TriangleMesh | None = None) -> Float32:
    """Return contact depths (N, H, W), metres, at the maximal depth, of the block or a mesh at the block's poses."""
    there = make_translation([0.0, 0.0, camera.standoff_m - make_block_scene().geometry.standoff_m]) @ poses
    drawn = ReferenceRenderer().render(make_stepped_block() if mesh is None else mesh, there, camera)
    return compute_contact_depth(drawn, camera, camera.max_depth_m)


def _mask_left(shapes: Float32, parts: int) -> Bools:
    """Return the seen pixels (N, H, W): all except the leftmost of `parts` equal parts."""
    seen = np.ones(shapes.shape, bool)
    seen[:, :, : shapes.shape[2] // parts] = False
    return seen


def _require_seen_as_plain(encoder: Encoder, shapes: Float32, press_m: float, camera: SensorGeometry) -> Float32:
    """Return the weights of fully seen shapes (N, H, W), metres.

    Raises ContractError unless the shapes have the embeddings of `encode`.
    """
    plain = _encode(encoder, shapes, press_m, camera)
    whole, weights = encoder.encode_seen(shapes, np.ones(shapes.shape, bool), press_m, camera)
    sentence = "fully seen shapes must have the embeddings of encode"
    _require_alike(whole, plain, plain, sentence, _name_inherited(encoder, "encode_seen"))
    require(weights.shape == plain.shape, f"weights {weights.shape} must have the embeddings' shape {plain.shape}")
    return weights


def _require_unseen_ignored(
    encoder: Encoder, shapes: Float32, seen: Bools, fill_m: float, press_m: float, camera: SensorGeometry
) -> tuple[Float32, Float32]:
    """Raise ContractError unless shapes (N, H, W), metres, have the same embeddings with `fill_m` at unseen pixels.

    Return the weights of the shapes and of the filled shapes.
    """
    filled = np.where(seen, shapes, np.float32(fill_m))
    (one, ones), (two, twos) = (encoder.encode_seen(some, seen, press_m, camera) for some in (shapes, filled))
    plain = _encode(encoder, shapes, press_m, camera)
    _require_alike(one * ones, two * twos, plain, "unseen pixels must change nothing")
    return ones, twos


def _name_inherited(encoder: Encoder, method: str) -> str:
    """Name the cause if the class that defines a method is another one than the class that defines `encode`."""
    owner, encodes = (next(base for base in type(encoder).__mro__ if name in vars(base)) for name in (method, "encode"))
    inherited = f"{method} is inherited from {owner.__name__}, whose encode differs; override both"
    return name_cause({inherited: owner not in (encodes, Encoder) and issubclass(encodes, owner)})


def _require_found(queries: Float32, bank: Float32, sentence: str, often: str = "") -> None:
    """Raise ContractError unless each query is nearest to its own row of the bank."""
    alike = {"all embeddings are equal": np.ptp(bank, axis=0).max() == 0}
    nearest = np.linalg.norm(queries[:, None] - bank[None], axis=-1).argmin(axis=1)
    _require_order(nearest, sentence, name_cause(alike, often=often))


def _require_order(found: np.ndarray, sentence: str, cause: str = "") -> None:
    require((found == np.arange(len(found))).all(), f"{sentence}; the nearest rows are {found.tolist()}", cause)


def _require_alike(value: Float32, truth: Float32, plain: Float32, sentence: str, cause: str = "") -> None:
    """Raise ContractError unless embeddings agree to a thousandth of the spread of `plain` embeddings."""
    require_close(value, truth, 1e-3 * _spread(plain), sentence, cause)


def _spread(vectors: Float32) -> float:
    """Return the embeddings' scale: their mean distance from their mean."""
    return float(np.linalg.norm(vectors - vectors.mean(axis=0), axis=-1).mean()) + 1e-12
