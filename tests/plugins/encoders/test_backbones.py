"""The networks of the learned encoder have the published shapes, and depend on nothing but their seed."""

import pytest

torch = pytest.importorskip("torch")

from tactile_loc.plugins.encoders.moco.backbones import Backbone, make_backbone  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")


def made(name: str = "small", seed: int = 0, planes: int = 1, channels: int = 16, norm: str = "group") -> Backbone:
    return make_backbone(name, torch.Generator().manual_seed(seed), planes, channels, norm)


def masks(count: int = 3, side_px: int = 64, seed: int = 1) -> torch.Tensor:
    drawn = torch.rand(count, 1, side_px, side_px, generator=torch.Generator().manual_seed(seed))
    return (drawn > 0.5).float()


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def test_the_residual_network_has_the_parameters_of_the_paper():
    """Without the classifier, and with three colours, ResNet-50 has 23 508 032 parameters."""
    model = made("resnet50", planes=3, norm="batch")
    count = sum(p.numel() for name, p in model.named_parameters() if not name.startswith("project"))
    assert count == 23_508_032
    assert [len(model.get_submodule(f"layer{k}")) for k in (1, 2, 3, 4)] == [3, 4, 6, 3]


@pytest.mark.parametrize(
    ("name", "channels", "height_px", "width_px", "cells"),
    [
        ("small", 16, 64, 64, (4, 4)),
        ("small", 16, 200, 200, (13, 13)),
        ("small", 16, 47, 33, (3, 3)),
        ("resnet50", 64, 200, 200, (7, 7)),  # 3136 numbers
        ("resnet50", 8, 64, 97, (2, 4)),
    ],
)
def test_the_vector_has_the_length_of_the_map(name, channels, height_px, width_px, cells):
    model = made(name, channels=channels).to("meta")  # shapes without the arithmetic
    images = torch.ones(2, 1, height_px, width_px, device="meta")
    assert cells == (-(-height_px // model.stride_px), -(-width_px // model.stride_px))
    assert model(images).shape == (2, channels * cells[0] * cells[1])


@pytest.mark.parametrize(("name", "side_px"), [("small", 192), ("resnet50", 576)])
def test_a_shift_by_the_stride_shifts_the_map_by_a_cell(name, side_px):
    # new batch norms in evaluation map zero to zero, so the image's border has no effect
    model = made(name, norm="batch").eval()
    at, step = side_px // 2, model.stride_px
    image = torch.zeros(2, 1, side_px, side_px)
    image[0, :, at - 8 : at + 8, at - 8 : at + 8] = masks(1, side_px=16)[0]
    image[1] = image[0].roll((step, -step), dims=(1, 2))
    with torch.inference_mode():
        here, there = model(image).reshape(2, 16, side_px // step, side_px // step)
    assert here.abs().max() > 1e-3
    torch.testing.assert_close(there[:, 1:, :-1], here[:, :-1, 1:], rtol=1e-4, atol=1e-5 * float(here.abs().max()))


@pytest.mark.parametrize("name", ["small", "resnet50"])
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
