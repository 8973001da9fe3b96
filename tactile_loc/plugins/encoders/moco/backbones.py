"""Convolutional backbones of the learned encoder in plain torch.

No network has average pooling: its output map is the feature vector.
"""

from typing import Literal

import torch
from torch import nn

BackboneName = Literal["small", "resnet50"]
Norm = Literal["batch", "group"]

_WIDTHS, _DEPTHS, _GROUPS = (64, 128, 256, 512), (3, 4, 6, 3), 32
_SMALL_WIDTHS, _SMALL_GROUPS = (24, 48, 96, 128), 8


class Backbone(nn.Module):
    """A fully convolutional network from images (N, in_channels, H, W) to a coarse map, which is the feature vector.

    "small" has four normalised 3x3 convolutions of stride 2 (24, 48, 96, 128 channels), for training on two CPU cores.
    A 64x64 image takes 15 MFLOP and gives a 4x4 map.

    "resnet50" is a residual network without average pooling and classifier (He et al., CVPR 2016). The 3x3 convolution
    of a bottleneck has the stride. With `norm="group"`, there are no running statistics, so images do not influence
    each other's features.

    A layer `project`, a 1x1 convolution to `channels` channels, follows. `stride_px` is the distance between the map's
    cells, in input pixels. Every convolution pads by half its kernel, so a cell covers the same place for every image
    size.
    """

    def __init__(self, name: BackboneName, in_channels: int, channels: int, norm: Norm) -> None:
        super().__init__()
        small = name == "small"
        self.name, self.stride_px, self.in_channels = name, 16 if small else 32, in_channels
        stages, width = _make_small(in_channels, norm) if small else _make_resnet(in_channels, norm)
        self.project = nn.Conv2d(width, channels, 1)
        for key, stage in stages.items():
            self.add_module(key, stage)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return the vectors (N, channels*h*w) of images (N, in_channels, H, W): the flattened map, not normalised."""
        if self.name == "small":  # its stages keep this layout, a fifth faster on a CPU; the weights stay contiguous
            images = images.to(memory_format=torch.channels_last)
        for key, stage in self.named_children():
            images = images if key == "project" else stage(images)
        projected: torch.Tensor = self.project(images)
        return projected.flatten(1)


def make_norm_layer(norm: Norm, width: int, groups: int) -> nn.Module:
    """Return a layer of batch normalisation, or of group normalisation in `groups` groups, for `width` channels."""
    return nn.BatchNorm2d(width) if norm == "batch" else nn.GroupNorm(groups, width)


def _make_small(in_channels: int, norm: Norm) -> tuple[dict[str, nn.Module], int]:
    """Return the stages of the small network by name, and the number of channels of its map."""
    stages, incoming = [], in_channels
    for width in _SMALL_WIDTHS:
        convolution = nn.Conv2d(incoming, width, 3, 2, 1, bias=False)
        stages.append(nn.Sequential(convolution, make_norm_layer(norm, width, _SMALL_GROUPS), nn.ReLU(inplace=True)))
        incoming = width
    return {"stages": nn.Sequential(*stages)}, incoming


def _make_resnet(in_channels: int, norm: Norm) -> tuple[dict[str, nn.Module], int]:
    """Return the stages of the residual network by name, and the number of channels of its map."""
    stages: dict[str, nn.Module] = {
        "conv1": nn.Conv2d(in_channels, 64, 7, 2, 3, bias=False),
        "bn1": make_norm_layer(norm, 64, _GROUPS),
        "relu": nn.ReLU(inplace=True),
        "maxpool": nn.MaxPool2d(3, 2, 1),
    }
    incoming = 64
    for number, (width, depth) in enumerate(zip(_WIDTHS, _DEPTHS, strict=True), start=1):
        blocks = []
        for position in range(depth):
            blocks.append(_Bottleneck(incoming, width, 2 if number > 1 and position == 0 else 1, norm))
            incoming = 4 * width
        stages[f"layer{number}"] = nn.Sequential(*blocks)
    return stages, incoming


class _Bottleneck(nn.Module):
    """Adds a branch of three normalised convolutions to the input. The first input of a stage is projected."""

    def __init__(self, incoming: int, width: int, stride: int, norm: Norm) -> None:
        super().__init__()
        self.relu = nn.ReLU(inplace=True)
        self.conv1 = nn.Conv2d(incoming, width, 1, bias=False)
        self.bn1 = make_norm_layer(norm, width, _GROUPS)
        self.conv2 = nn.Conv2d(width, width, 3, stride, 1, bias=False)
        self.bn2 = make_norm_layer(norm, width, _GROUPS)
        self.conv3 = nn.Conv2d(width, 4 * width, 1, bias=False)
        self.bn3 = make_norm_layer(norm, 4 * width, _GROUPS)
        self.downsample: nn.Module = nn.Identity()
        if incoming != 4 * width:
            shortcut = nn.Conv2d(incoming, 4 * width, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, make_norm_layer(norm, 4 * width, _GROUPS))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        branch = self.relu(self.bn1(self.conv1(x)))
        branch = self.bn3(self.conv3(self.relu(self.bn2(self.conv2(branch)))))
        added: torch.Tensor = self.relu(branch + self.downsample(x))
        return added


def make_backbone(
    name: BackboneName, generator: torch.Generator, in_channels: int, channels: int, norm: Norm
) -> Backbone:
    """Return a backbone on the CPU, with weights drawn by `generator`.

    `in_channels` is the number of input planes, of which the first is the contact mask. `channels` is the number of
    channels of the map. Torch's global random state is neither read nor changed.
    """
    with torch.device("meta"):  # torch's own initialisation would draw from the global random state
        model = Backbone(name, in_channels, channels, norm)
    model.to_empty(device="cpu")
    _initialise(model, generator)
    return model


def _initialise(model: Backbone, generator: torch.Generator) -> None:
    """Draw the weights from He's normal distribution. Normalisation layers start as the identity."""
    for module in model.modules():
        if isinstance(module, nn.Conv2d):
            linear = module is model.project
            mode, after = ("fan_in", "linear") if linear else ("fan_out", "relu")
            nn.init.kaiming_normal_(module.weight, mode=mode, nonlinearity=after, generator=generator)  # type: ignore[arg-type]
            if module.bias is not None:
                nn.init.zeros_(module.bias)
        elif isinstance(module, nn.BatchNorm2d | nn.GroupNorm):
            module.reset_parameters()  # ones and zeros, and fresh running statistics
