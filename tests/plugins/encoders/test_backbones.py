from functools import cache
from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ConfigError, WeightsError

torch = pytest.importorskip("torch")
safetensors = pytest.importorskip("safetensors.torch")

from tactile_loc.plugins.encoders.moco.backbones import BACKBONES, Backbone, load_pretrained, make_backbone  # noqa: E402

STATISTICS = ("running_mean", "running_var", "num_batches_tracked")


pytestmark = pytest.mark.usefixtures("one_thread")


def made(name: str = "small", seed: int = 0, **options: object) -> Backbone:
    return make_backbone(name, generator=torch.Generator().manual_seed(seed), **options)


def masks(count: int = 3, planes: int = 1, side_px: int = 64, seed: int = 1) -> torch.Tensor:
    drawn = torch.rand(count, planes, side_px, side_px, generator=torch.Generator().manual_seed(seed))
    return (drawn > 0.5).float()


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def copied(model: Backbone) -> dict[str, torch.Tensor]:
    return {key: value.clone() for key, value in model.state_dict().items()}


def saved(weights: dict[str, torch.Tensor], path: Path) -> Path:
    safetensors.save_file(weights, path)
    return path


def norm_shapes(layer: str, width: int) -> dict[str, tuple[int, ...]]:
    shapes = {f"{layer}.{key}": (width,) for key in ("weight", "bias", "running_mean", "running_var")}
    return shapes | {f"{layer}.num_batches_tracked": ()}


def torchvision_shapes(name: str) -> dict[str, tuple[int, ...]]:
    """Names and shapes of torchvision's state dict without the classifier, taken from the papers' tables."""
    shapes: dict[str, tuple[int, ...]] = {"conv1.weight": (64, 3, 7, 7)} | norm_shapes("bn1", 64)
    deep = name == "resnet50"
    incoming = 64
    for layer, (width, depth) in enumerate(
        zip((64, 128, 256, 512), (3, 4, 6, 3) if deep else (2,) * 4, strict=True), 1
    ):
        out = 4 * width if deep else width
        for block in range(depth):
            at = f"layer{layer}.{block}"
            convolutions = [(width, incoming, 3), (width, width, 3)]
            if deep:
                convolutions = [(width, incoming, 1), (width, width, 3), (out, width, 1)]
            for number, (outgoing, into, side) in enumerate(convolutions, 1):
                shapes[f"{at}.conv{number}.weight"] = (outgoing, into, side, side)
                shapes |= norm_shapes(f"{at}.bn{number}", outgoing)
            if block == 0 and (layer > 1 or deep):
                shapes[f"{at}.downsample.0.weight"] = (out, incoming, 1, 1)
                shapes |= norm_shapes(f"{at}.downsample.1", out)
            incoming = out
    return shapes


@cache
def torchvision_weights(name: str, seed: int = 5) -> dict[str, torch.Tensor]:
    """The tensors of a torchvision file, including the classifier, with random values."""
    generator = torch.Generator().manual_seed(seed)
    shapes = torchvision_shapes(name) | {"fc.weight": (1000, 512 if name == "resnet18" else 2048), "fc.bias": (1000,)}
    return {
        key: torch.tensor(3) if key.endswith("tracked") else torch.rand(shape, generator=generator)
        for key, shape in shapes.items()
    }


@pytest.mark.parametrize(("name", "parameters"), [("resnet18", 11_176_512), ("resnet50", 23_508_032)])
def test_residual_networks_have_the_names_and_shapes_of_torchvision(name, parameters):
    model = made(name, in_channels=3, channels=None, norm="batch")
    assert {key: tuple(value.shape) for key, value in model.state_dict().items()} == torchvision_shapes(name)
    assert sum(parameter.numel() for parameter in model.parameters()) == parameters


@pytest.mark.parametrize("name", ["resnet18", "resnet50"])
def test_group_norm_keeps_the_names_and_drops_the_running_statistics(name):
    expected = {key for key in torchvision_shapes(name) if not key.endswith(STATISTICS)}
    assert made(name, channels=None, norm="group").state_dict().keys() == expected


@pytest.mark.parametrize(
    ("name", "channels", "height_px", "width_px", "shape"),
    [
        ("small", 16, 64, 64, (16, 4, 4)),
        ("small", 16, 200, 200, (16, 13, 13)),
        ("small", None, 64, 48, (128, 4, 3)),
        ("small", 16, 47, 33, (16, 3, 3)),
        ("resnet18", 64, 64, 64, (64, 2, 2)),
        ("resnet18", None, 200, 200, (512, 7, 7)),
        ("resnet50", None, 200, 200, (2048, 7, 7)),
        ("resnet50", 128, 160, 160, (128, 5, 5)),
        ("resnet50", 8, 64, 97, (8, 2, 4)),
    ],
)
def test_the_feature_map_has_the_shape_of_the_stride(name, channels, height_px, width_px, shape):
    model = made(name, channels=channels).to("meta")  # shapes without the arithmetic
    images = torch.ones(2, 1, height_px, width_px, device="meta")
    assert shape[1:] == (-(-height_px // model.stride_px), -(-width_px // model.stride_px))
    assert model.feature_map(images).shape == (2, *shape)
    assert model(images).shape == (2, shape[0] * shape[1] * shape[2])


@pytest.mark.parametrize(("name", "side_px"), [("small", 192), ("resnet18", 576)])
def test_a_shift_by_the_stride_shifts_the_feature_map_by_a_cell(name, side_px):
    # new batch norms in evaluation map zero to zero, so the image's border has no effect
    model = made(name, norm="batch").eval()
    at, step = side_px // 2, model.stride_px
    image = torch.zeros(2, 1, side_px, side_px)
    image[0, :, at - 8 : at + 8, at - 8 : at + 8] = masks(1, side_px=16)[0]
    image[1] = image[0].roll((step, -step), dims=(1, 2))
    with torch.inference_mode():
        here, there = model.feature_map(image)
    assert here.abs().max() > 1e-3
    torch.testing.assert_close(there[:, 1:, :-1], here[:, :-1, 1:], rtol=1e-4, atol=1e-5 * float(here.abs().max()))


@pytest.mark.parametrize("name", BACKBONES)
def test_the_weights_depend_on_the_seed_and_not_on_the_global_state(name):
    torch.manual_seed(7)
    state = torch.get_rng_state()
    first = made(name).state_dict()
    assert torch.equal(torch.get_rng_state(), state)
    torch.manual_seed(8)
    assert same(first, made(name).state_dict())
    assert not same(first, made(name, seed=1).state_dict())
    assert all(torch.isfinite(value).all() for value in first.values())


def test_only_batch_norm_mixes_images_in_training():
    images, others = masks(4), masks(4, seed=2)
    others[0] = images[0]
    mixes = {norm: made(norm=norm).train() for norm in ("group", "batch")}
    apart = {norm: float((model(images)[0] - model(others)[0]).detach().abs().max()) for norm, model in mixes.items()}
    assert apart["group"] < 1e-5
    assert apart["batch"] > 1e-3


@pytest.mark.parametrize(
    ("options", "values"),
    [
        ({"name": "resnet81"}, ("'resnet81'", "'resnet18'")),
        ({"in_channels": 0}, ("in_channels", 1, 0)),
        ({"channels": -2}, ("channels", 1, -2)),
        ({"norm": "layer"}, ("'layer'", "'batch'", "'group'")),
    ],
)
def test_invalid_network_options_are_refused(options, values):
    with pytest.raises(ConfigError, match=naming(*values)):
        made(**options)


@pytest.mark.parametrize(
    ("name", "norm", "left_out"),
    [
        ("resnet18", "batch", ()),
        ("resnet50", "batch", ()),
        ("resnet18", "batch", ("num_batches_tracked",)),
        ("resnet18", "group", ()),  # it has no statistics
    ],
)
def test_torchvision_files_fill_all_layers_but_the_projection(tmp_path, name, norm, left_out):
    weights = {key: value for key, value in torchvision_weights(name).items() if not key.endswith(left_out)}
    model = made(name, in_channels=3, norm=norm)
    before = copied(model)
    load_pretrained(model, saved(weights, tmp_path / "weights.safetensors"))
    after = model.state_dict()
    filled = {key for key in weights.keys() - {"fc.weight", "fc.bias"} if norm == "batch" or key in after}
    kept = {key for key in after.keys() - filled if not key.endswith("tracked")}
    assert kept == {"project.weight", "project.bias"}
    assert all(torch.equal(after[key], weights[key]) for key in filled)
    assert all(torch.equal(after[key], before[key]) for key in kept)


@pytest.mark.parametrize("planes", [1, 2])
def test_colour_weights_treat_one_plane_as_three_equal_planes(tmp_path, planes):
    path = saved(torchvision_weights("resnet18"), tmp_path / "weights.safetensors")
    colour, gray = (made("resnet18", in_channels=count) for count in (3, planes))
    load_pretrained(colour, path)
    load_pretrained(gray, path)
    images = masks(2, planes=planes)
    with torch.inference_mode():  # later layers would remove a wrong scale
        expected = colour.get_submodule("conv1")(images[:, :1].repeat(1, 3, 1, 1))
        torch.testing.assert_close(gray.get_submodule("conv1")(images), expected, rtol=1e-4, atol=1e-4)


def refused(model: Backbone, path: Path, *said: str) -> str:
    """Return the message that refuses `path`; the file is named and the model is unchanged."""
    before = copied(model)
    with pytest.raises(WeightsError) as caught:
        load_pretrained(model, path)
    message = str(caught.value)
    assert all(part in message for part in (str(path), *said)), message
    assert "\n" not in message
    assert same(before, model.state_dict())
    return message


def changed(key: str, change) -> dict[str, torch.Tensor]:
    """The weights of a small network with another tensor, or without the tensor if `change` gives None."""
    weights = made("small").state_dict()
    tensor = change(weights.pop(key, None))
    return weights if tensor is None else weights | {key: tensor.contiguous()}


@pytest.mark.parametrize(
    ("options", "weights", "said"),
    [
        ({}, changed("stages.3.1.bias", lambda _: None), ["'stages.3.1.bias'"]),
        ({}, changed("project.bias", lambda _: None), ["'project.bias'"]),
        ({}, changed("head.weight", lambda _: torch.zeros(2)), ["'head.weight'"]),
        ({}, changed("stages.0.0.weight", lambda w: w[:, :, :2]), ["'stages.0.0.weight'", "(24, 1, 2, 3)"]),
        ({}, changed("stages.0.0.weight", lambda w: w.long()), ["'stages.0.0.weight'", "torch.int64"]),
        ({}, changed("stages.2.0.weight", lambda w: w * torch.nan), ["'stages.2.0.weight'", "finite"]),
        ({"channels": 8}, made().state_dict(), ["'project.weight'", "(16, 128, 1, 1)", "(8, 128, 1, 1)"]),
        ({"channels": None}, made().state_dict(), ["'project."]),
        ({"norm": "batch"}, made().state_dict(), ["'stages.0.1.running_mean'"]),
        ({}, torchvision_weights("resnet18"), ["small", "'stages.0.0.weight'"]),
        ({"name": "resnet18"}, torchvision_weights("resnet50"), ["resnet18", "'layer1.0.conv1.weight'"]),
    ],
)
def test_mismatched_weights_are_refused_and_leave_the_model_unchanged(tmp_path, options, weights, said):
    refused(made(**options), saved(weights, tmp_path / "weights.safetensors"), *said)


def test_a_missing_file_is_refused(tmp_path):
    refused(made("small"), tmp_path / "weights.safetensors")


def test_a_damaged_file_is_refused(tmp_path):
    whole = saved(made("small").state_dict(), tmp_path / "whole.safetensors").read_bytes()
    path = tmp_path / "weights.safetensors"
    pieces = [whole[: int(len(whole) * share)] for share in (0, 1e-5, 1e-4, 1e-3, 0.01, 0.5, 0.9, 0.999)]
    for content in [*pieces, b"no weights at all", b"\x80\x02}q\x00X", b"(lp0\nI1\na", b"\x00" * 512]:
        path.write_bytes(content)
        refused(made("small"), path, "damaged")


class Command:
    def __reduce__(self):
        return Path.touch, (Path("harm-done"),)


@pytest.mark.parametrize("suffix", [".pth", ".pt", ".h5", ""])
def test_only_safetensors_files_are_read_and_no_file_runs_code(tmp_path, monkeypatch, suffix):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"weights{suffix}"
    torch.save({"stages": Command()}, path)
    refused(made("small"), path, ".safetensors", "docs/training.md")
    as_others = path.replace(tmp_path / "weights.safetensors")
    refused(made("small"), as_others, "damaged")
    assert not (tmp_path / "harm-done").exists()
