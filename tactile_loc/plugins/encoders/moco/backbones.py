"""Convolutional backbones of the learned encoder in plain torch, and pretrained weights.

Residual networks use torchvision's parameter names. No network has average pooling: its output map is the feature
vector.
"""

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from tactile_loc.plugin import ConfigError, WeightsError
from tactile_loc.plugin.helpers import did_you_mean

log = logging.getLogger(__name__)

Norm = Literal["batch", "group"]

RESNET_DEPTHS = {"resnet18": (2, 2, 2, 2), "resnet50": (3, 4, 6, 3)}
BACKBONES = ("small", *RESNET_DEPTHS)
_WIDTHS, _GROUPS = (64, 128, 256, 512), 32
_SMALL_WIDTHS, _SMALL_GROUPS = (24, 48, 96, 128), 8
_STATISTICS = ("running_mean", "running_var", "num_batches_tracked")


class Backbone(nn.Module):
    """A fully convolutional network from images (N, in_channels, H, W) to a coarse map, which is the feature vector.

    "small" has four normalised 3x3 convolutions of stride 2 (24, 48, 96, 128 channels), for training on two CPU cores.
    A 64x64 image takes 15 MFLOP and gives a 4x4 map.

    "resnet18" and "resnet50" are residual networks without average pooling and classifier. With `norm="batch"` and
    three input channels, every parameter and buffer has torchvision's name and shape. As in torchvision's version 1.5,
    the 3x3 convolution of a bottleneck has the stride. With `norm="group"`, the names are the same, but there are no
    running statistics, so images do not influence each other's features.

    A layer `project`, a 1x1 convolution to `channels` channels, follows. With `channels=None`, it is left out, and the
    map has 128, 512 or 2048 channels. `stride_px` is the distance between the map's cells, in input pixels. Every
    convolution pads by half its kernel, so a cell covers the same place for every image size.
    """

    def __init__(self, name: str, in_channels: int, channels: int | None, norm: Norm) -> None:
        super().__init__()
        small = name == "small"
        self.name, self.stride_px, self.in_channels = name, 16 if small else 32, in_channels
        stages, width = _make_small(in_channels, norm) if small else _make_resnet(name, in_channels, norm)
        self.project: nn.Module = nn.Identity() if channels is None else nn.Conv2d(width, channels, 1)
        for key, stage in stages.items():
            self.add_module(key, stage)

    def feature_map(self, images: torch.Tensor) -> torch.Tensor:
        """Return the map (N, channels, h, w) of images (N, in_channels, H, W)."""
        if self.name == "small":  # its stages keep this layout, a fifth faster on a CPU; the weights stay contiguous
            images = images.to(memory_format=torch.channels_last)
        for key, stage in self.named_children():
            images = images if key == "project" else stage(images)
        projected: torch.Tensor = self.project(images)
        return projected

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return the vectors (N, channels*h*w) of images (N, in_channels, H, W): the flattened map, not normalised."""
        return self.feature_map(images).flatten(1)


def make_norm_layer(norm: Norm, width: int, groups: int) -> nn.Module:
    """Return a layer of batch normalisation, or of group normalisation in `groups` groups, for `width` channels.

    Raises ConfigError when `norm` is neither "batch" nor "group".
    """
    if norm == "batch":
        return nn.BatchNorm2d(width)
    if norm == "group":
        return nn.GroupNorm(groups, width)
    raise ConfigError(f"there is no normalisation {norm!r}; choose 'batch' or 'group'")


def _make_small(in_channels: int, norm: Norm) -> tuple[dict[str, nn.Module], int]:
    """Return the stages of the small network by name, and the number of channels of its map."""
    stages, incoming = [], in_channels
    for width in _SMALL_WIDTHS:
        convolution = nn.Conv2d(incoming, width, 3, 2, 1, bias=False)
        stages.append(nn.Sequential(convolution, make_norm_layer(norm, width, _SMALL_GROUPS), nn.ReLU(inplace=True)))
        incoming = width
    return {"stages": nn.Sequential(*stages)}, incoming


def _make_resnet(name: str, in_channels: int, norm: Norm) -> tuple[dict[str, nn.Module], int]:
    """Return the stages of a residual network by name, and the number of channels of its map."""
    stages: dict[str, nn.Module] = {
        "conv1": nn.Conv2d(in_channels, 64, 7, 2, 3, bias=False),
        "bn1": make_norm_layer(norm, 64, _GROUPS),
        "relu": nn.ReLU(inplace=True),
        "maxpool": nn.MaxPool2d(3, 2, 1),
    }
    incoming = 64
    for number, (width, depth) in enumerate(zip(_WIDTHS, RESNET_DEPTHS[name], strict=True), start=1):
        blocks = []
        for position in range(depth):
            convolutions = _list_convolutions(name, width, 2 if number > 1 and position == 0 else 1)
            blocks.append(_Block(incoming, convolutions, norm))
            incoming = convolutions[-1][0]
        stages[f"layer{number}"] = nn.Sequential(*blocks)
    return stages, incoming


class _Block(nn.Module):
    """Adds a branch of normalised convolutions to the input. The input is projected if the shapes differ.

    `convolutions` lists (channels, kernel, stride) of each convolution in the branch.
    """

    def __init__(self, incoming: int, convolutions: Sequence[tuple[int, int, int]], norm: Norm) -> None:
        super().__init__()
        self.depth = len(convolutions)
        self.relu = nn.ReLU(inplace=True)
        into, total_stride = incoming, 1
        for number, (width, kernel, stride) in enumerate(convolutions, 1):
            self.add_module(f"conv{number}", nn.Conv2d(into, width, kernel, stride, kernel // 2, bias=False))
            self.add_module(f"bn{number}", make_norm_layer(norm, width, _GROUPS))
            into, total_stride = width, total_stride * stride
        self.downsample: nn.Module | None = None
        if total_stride != 1 or incoming != into:
            shortcut = nn.Conv2d(incoming, into, 1, total_stride, bias=False)
            self.downsample = nn.Sequential(shortcut, make_norm_layer(norm, into, _GROUPS))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        branch = x
        for number in range(1, self.depth + 1):
            branch = self.get_submodule(f"bn{number}")(self.get_submodule(f"conv{number}")(branch))
            if number < self.depth:
                branch = self.relu(branch)
        added: torch.Tensor = self.relu(branch + (x if self.downsample is None else self.downsample(x)))
        return added


def _list_convolutions(name: str, width: int, stride: int) -> list[tuple[int, int, int]]:
    """Return the (channels, kernel, stride) of a block's branch: two 3x3 convolutions, or a bottleneck."""
    if name == "resnet18":
        return [(width, 3, stride), (width, 3, 1)]
    return [(width, 1, 1), (width, 3, stride), (4 * width, 1, 1)]


def make_backbone(
    name: str, *, generator: torch.Generator, in_channels: int = 1, channels: int | None = 16, norm: Norm = "group"
) -> Backbone:
    """Return the backbone `name` ("small", "resnet18", "resnet50") on the CPU, with weights drawn by `generator`.

    `in_channels` is the number of input planes, of which the first is the contact mask. `channels` is the number of
    channels of the map. None keeps the network's own number of channels, without projection. Torch's global random
    state is neither read nor changed. Raises ConfigError for an unknown name or norm, or a number below 1.
    """
    if name not in BACKBONES:
        near = did_you_mean(name, BACKBONES)
        raise ConfigError(
            f"there is no backbone {name!r}; choose one of {', '.join(BACKBONES)}" + (near and f".{near}")
        )
    for label, count in (("in_channels", in_channels), ("channels", channels)):
        if count is not None and count < 1:
            raise ConfigError(f"the backbone's {label} is {count}; it must be at least 1")
    with torch.device("meta"):  # torch's own initialisation would draw from the global random state
        model = Backbone(name, in_channels, channels, norm)
    model.to_empty(device="cpu")
    _initialise(model, generator)
    return model


def _initialise(model: Backbone, generator: torch.Generator) -> None:
    """Draw the weights from He's normal distribution, as torchvision does for residual networks.

    Normalisation layers start as the identity.
    """
    for module in model.modules():
        if isinstance(module, nn.Conv2d):
            linear = module is model.project
            mode, after = ("fan_in", "linear") if linear else ("fan_out", "relu")
            nn.init.kaiming_normal_(module.weight, mode=mode, nonlinearity=after, generator=generator)  # type: ignore[arg-type]
            if module.bias is not None:
                nn.init.zeros_(module.bias)
        elif isinstance(module, nn.BatchNorm2d | nn.GroupNorm):
            module.reset_parameters()  # ones and zeros, and fresh running statistics


def load_pretrained(model: Backbone, source: str | Path) -> None:
    """Fill `model` with the weights in `source`, a .safetensors file. Pickles, torch's own format, are never read.

    The file has torchvision's names, or the names of a saved `model.state_dict()`. `fc.*` is ignored. If the file has
    no `project.*`, the model keeps its own projection. The file's first convolution may take three colours, and the
    model another number of planes. The weights of the mask's plane are then the sum over the colours, and those of
    further planes are zero. A model with group norms takes the scales and shifts of batch norms without their running
    statistics, so the model needs fine-tuning.

    Raises WeightsError, and leaves the model unchanged, when the weights are missing, damaged, or of another
    architecture.
    """
    fitted = _fit_weights(model, _read_weights(Path(source)), str(source))
    model.load_state_dict(fitted, strict=False)
    log.debug("loaded %d tensors of %s from %s", len(fitted), model.name, source)


def _read_weights(path: Path) -> Mapping[str, torch.Tensor]:
    if path.suffix != ".safetensors":
        raise WeightsError(
            f"the weights {path} are not a .safetensors file, the only format without code; convert them with the "
            "command in docs/training.md"
        )
    if not os.path.isfile(path):
        raise WeightsError(f"there is no weights file {path}; check the path")
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except OSError as error:
        raise WeightsError(f"the weights file {path} cannot be read ({error.strerror or error})") from error
    except SafetensorError as error:
        raise WeightsError(f"the weights file {path} is damaged; download or save it again") from error


def _fit_weights(model: Backbone, weights: Mapping[str, torch.Tensor], origin: str) -> dict[str, torch.Tensor]:
    """Return the tensors of `weights` that belong to the model. Raises WeightsError unless they are complete."""
    own = model.state_dict()
    given = {key: value for key, value in weights.items() if not _is_ignored(key, own)}
    for key in dict.fromkeys([*own, *given]):
        if key == "conv1.weight" and key in given and key in own:
            given[key] = _adapt_kernel(given[key], own[key])
        if key not in given:
            problem = "" if _is_optional(key, given) else f"it has no {key!r}"
        else:
            problem = _find_difference(given[key], own[key]) if key in own else "is of another network"
            problem = problem and f"its {key!r} {problem}"
        if problem:
            naming = "torchvision's" if model.name in RESNET_DEPTHS else "this library's"
            advice = f"give weights of {model.name} with {naming} names"
            raise WeightsError(f"{origin} does not fit {model.name}: {problem}; {advice}")
    return given


def _is_ignored(key: str, own: Mapping[str, torch.Tensor]) -> bool:
    """Return true for the classifier, and for running statistics that the model does not have."""
    layer, _, parameter = key.rpartition(".")
    return key.startswith("fc.") or (parameter in _STATISTICS and key not in own and f"{layer}.weight" in own)


def _is_optional(key: str, given: Mapping[str, torch.Tensor]) -> bool:
    """Return true for the number of batches, which old files lack, and for a projection that is missing completely."""
    projection = key.startswith("project.") and not any(other.startswith("project.") for other in given)
    return projection or key.endswith(".num_batches_tracked")


def _adapt_kernel(kernel: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """Convert a first convolution on three colours to the planes of `place`, and return any other kernel unchanged."""
    if kernel.ndim != 4 or kernel.shape[1] != 3 or place.shape[1] == 3:
        return kernel
    planes = kernel.new_zeros((len(kernel), place.shape[1], *kernel.shape[2:]))
    planes[:, 0] = kernel.sum(1)
    return planes


def _find_difference(tensor: torch.Tensor, place: torch.Tensor) -> str:
    """Return why `tensor` does not fit into `place`, as the end of a sentence, or an empty string."""
    if tensor.shape != place.shape:
        return f"has shape {tuple(tensor.shape)} instead of {tuple(place.shape)}"
    if tensor.is_floating_point() != place.is_floating_point():
        return f"has type {tensor.dtype} instead of {place.dtype}"
    return "" if torch.isfinite(tensor).all() else "holds numbers that are not finite"
