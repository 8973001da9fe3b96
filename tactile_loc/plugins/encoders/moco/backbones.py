"""Convolutional backbones of the learned encoder in plain torch, and pretrained weights.

Residual networks use torchvision's parameter names. No network has average pooling: its output map is the feature
vector.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from tactile_loc.plugin import ConfigError, MissingLibraryError, WeightsError, did_you_mean

Norm = Literal["batch", "group"]

RESNET_DEPTHS = {"resnet18": (2, 2, 2, 2), "resnet50": (3, 4, 6, 3)}
_WIDTHS = (64, 128, 256, 512)
_GROUPS = 32


class Backbone(nn.Module):
    """A fully convolutional network from images (N, in_channels, H, W) to a coarse map, which is the feature vector.

    `name` is the architecture. `stride_px` is the distance between the map's cells, in input pixels. `in_channels` and
    `channels` are the numbers of channels of the input and of the map. Every convolution pads by half its kernel, so a
    cell covers the same place for every image size.
    """

    def __init__(self, name: str, stride_px: int, in_channels: int, width: int, channels: int | None) -> None:
        super().__init__()
        self.name, self.stride_px, self.in_channels = name, stride_px, in_channels
        self.channels = width if channels is None else channels
        self.project: nn.Module = nn.Identity() if channels is None else nn.Conv2d(width, channels, 1)

    def features(self, images: torch.Tensor) -> torch.Tensor:
        """Return the unprojected map (N, width, h, w) of images (N, in_channels, H, W)."""
        raise NotImplementedError

    def feature_map(self, images: torch.Tensor) -> torch.Tensor:
        """Return the map (N, channels, h, w) of images (N, in_channels, H, W)."""
        projected: torch.Tensor = self.project(self.features(images))
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


class ResNet(Backbone):
    """ResNet-18 or ResNet-50 without average pooling and classifier; the stride is 32 px.

    With `norm="batch"` and three input channels, every parameter and buffer has torchvision's name and shape. As in
    torchvision's version 1.5, the 3x3 convolution of a bottleneck has the stride. With `norm="group"`, the names are
    the same, but there are no running statistics, so images do not influence each other's features. The layer
    `project`, a 1x1 convolution to `channels` channels, is added. With `channels=None`, it is left out, and the map has
    512 or 2048 channels.
    """

    def __init__(self, name: str, in_channels: int, channels: int | None, norm: Norm) -> None:
        super().__init__(name, 32, in_channels, _list_convolutions(name, _WIDTHS[-1], 1)[-1][0], channels)
        self.conv1 = nn.Conv2d(in_channels, 64, 7, 2, 3, bias=False)
        self.bn1 = make_norm_layer(norm, 64, _GROUPS)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        incoming = 64
        for index, (width, depth) in enumerate(zip(_WIDTHS, RESNET_DEPTHS[name], strict=True)):
            blocks = []
            for position in range(depth):
                stride = 2 if index and not position else 1
                convolutions = _list_convolutions(name, width, stride)
                blocks.append(_Block(incoming, convolutions, norm))
                incoming = convolutions[-1][0]
            self.add_module(f"layer{index + 1}", nn.Sequential(*blocks))

    def features(self, images: torch.Tensor) -> torch.Tensor:
        """Return the unprojected map (N, 512 or 2048, h, w) of images (N, in_channels, H, W)."""
        x = self.maxpool(self.relu(self.bn1(self.conv1(images))))
        for index in range(len(_WIDTHS)):
            x = self.get_submodule(f"layer{index + 1}")(x)
        return x


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


BACKBONES = ("small", *RESNET_DEPTHS)

_LOG = logging.getLogger(__name__)
_SMALL_WIDTHS = (24, 48, 96, 128)
_STATISTICS = ("running_mean", "running_var", "num_batches_tracked")


class SmallBackbone(Backbone):
    """Four normalised 3x3 convolutions of stride 2 (24, 48, 96, 128 channels), for training on two CPU cores.

    A 64x64 image takes 15 MFLOP and gives a 4x4 map; the stride is 16 px.
    """

    def __init__(self, in_channels: int, channels: int | None, norm: Norm) -> None:
        super().__init__("small", 16, in_channels, _SMALL_WIDTHS[-1], channels)
        stages, incoming = [], in_channels
        for width in _SMALL_WIDTHS:
            convolution = nn.Conv2d(incoming, width, 3, 2, 1, bias=False)
            stages.append(nn.Sequential(convolution, make_norm_layer(norm, width, 8), nn.ReLU(inplace=True)))
            incoming = width
        self.stages = nn.Sequential(*stages)

    def features(self, images: torch.Tensor) -> torch.Tensor:
        """Return the unprojected map (N, 128, h, w) of images (N, in_channels, H, W)."""
        # the stages keep this memory layout and are a fifth faster in it on a CPU; the weights stay contiguous
        features: torch.Tensor = self.stages(images.to(memory_format=torch.channels_last))
        return features


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
        small = name == "small"
        model = SmallBackbone(in_channels, channels, norm) if small else ResNet(name, in_channels, channels, norm)
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
    _LOG.debug("loaded %d tensors of %s from %s", len(fitted), model.name, source)


def _read_weights(path: Path) -> Mapping[str, torch.Tensor]:
    if path.suffix != ".safetensors":
        raise WeightsError(
            f"the weights {path} are not a .safetensors file, the only format without code; convert them with the "
            "command in docs/training.md"
        )
    if not os.path.isfile(path):
        raise WeightsError(f"there is no weights file {path}; check the path")
    try:
        from safetensors import SafetensorError
        from safetensors.torch import load_file
    except ImportError as error:
        raise MissingLibraryError(
            f"{path} needs safetensors, which is not installed: pip install safetensors"
        ) from error
    try:
        return load_file(path)
    except OSError as error:
        raise WeightsError(f"the weights file {path} cannot be read ({error.strerror or error})") from error
    except SafetensorError as error:
        raise WeightsError(f"the weights file {path} is damaged; download or save it again") from error


def _fit_weights(model: Backbone, weights: Mapping[str, torch.Tensor], origin: str) -> dict[str, torch.Tensor]:
    """Return the tensors of `weights` that belong to the model. Raises WeightsError unless they are complete."""
    own = model.state_dict()
    naming = "torchvision's" if model.name in RESNET_DEPTHS else "this library's"
    advice = f"give weights of {model.name} with {naming} names"
    given = {key: value for key, value in weights.items() if not _is_ignored(key, own)}
    fitted = {}
    for key, place in own.items():
        if key not in given and not _is_optional(key, given):
            raise WeightsError(f"{origin} does not fit {model.name}: it has no {key!r}; {advice}")
        if key in given:
            tensor = _adapt_kernel(given[key], place) if key == "conv1.weight" else given[key]
            if difference := _find_difference(tensor, place):
                raise WeightsError(f"{origin} does not fit {model.name}: {key!r} {difference}; {advice}")
            fitted[key] = tensor
    if foreign := next((key for key in given if key not in own), None):
        raise WeightsError(f"{origin} does not fit {model.name}, which has no {foreign!r}; {advice}")
    return fitted


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
