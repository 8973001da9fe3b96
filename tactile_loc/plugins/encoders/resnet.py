"""Residual networks with torchvision's parameter names, cropped before average pooling: the map is the feature."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import nn

from tactile_loc.plugin import ConfigError

Norm = Literal["batch", "group"]

RESNET_DEPTHS = {"resnet18": (2, 2, 2, 2), "resnet50": (3, 4, 6, 3)}
_WIDTHS = (64, 128, 256, 512)
_GROUPS = 32


class Backbone(nn.Module):
    """A fully convolutional network: images (N, in_channels, H, W) to a coarse map, whose values are the vector.

    `name` is the architecture, `stride_px` the input pixels from one cell of the map to the next, `in_channels` and
    `channels` the channels of the input and of the map. Every convolution pads by half its kernel, so a cell covers
    the same place of the image whatever the image's size.
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
        """Return the map (N, channels, h, w) of images (N, in_channels, H, W), of the sizes `map_shape` tells."""
        projected: torch.Tensor = self.project(self.features(images))
        return projected

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return the vectors (N, channels*h*w) of images (N, in_channels, H, W): the map flattened, not normalised."""
        return self.feature_map(images).flatten(1)

    def map_shape(self, height_px: int, width_px: int) -> tuple[int, int, int]:
        """Return (channels, h, w) of the map of an image `height_px` by `width_px`; their product is the dimension."""
        return self.channels, -(-height_px // self.stride_px), -(-width_px // self.stride_px)


def norm_layer(norm: Norm, width: int, groups: int) -> nn.Module:
    """Return batch normalisation, or group normalisation in `groups` groups, of `width` channels.

    Raises ConfigError when `norm` is neither "batch" nor "group".
    """
    if norm == "batch":
        return nn.BatchNorm2d(width)
    if norm == "group":
        return nn.GroupNorm(groups, width)
    raise ConfigError(f"The normalisation {norm!r} is unknown: choose 'batch' or 'group'.")


class ResNet(Backbone):
    """ResNet-18 or ResNet-50 without average pooling and classifier; the stride is 32 px.

    With `norm="batch"` and three input channels, every parameter and buffer has torchvision's name and shape (v1.5: the
    3x3 convolution of a bottleneck carries the stride). With `norm="group"` the names stay, and only the running
    statistics are absent: no image then influences another one's features, in training or after. `project`, a 1x1
    convolution to `channels`, is this library's own; with `channels=None` there is none and the map keeps 512 or 2048.
    """

    def __init__(self, name: str, in_channels: int, channels: int | None, norm: Norm) -> None:
        super().__init__(name, 32, in_channels, _convolutions(name, _WIDTHS[-1], 1)[-1][0], channels)
        self.conv1 = nn.Conv2d(in_channels, 64, 7, 2, 3, bias=False)
        self.bn1 = norm_layer(norm, 64, _GROUPS)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        incoming = 64
        for index, (width, depth) in enumerate(zip(_WIDTHS, RESNET_DEPTHS[name], strict=True)):
            blocks = []
            for position in range(depth):
                stride = 2 if index and not position else 1
                convolutions = _convolutions(name, width, stride)
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
    """A branch of normalised convolutions added to its input, which is projected where the shapes differ.

    `convolutions` lists the branch's (channels, kernel, stride).
    """

    def __init__(self, incoming: int, convolutions: Sequence[tuple[int, int, int]], norm: Norm) -> None:
        super().__init__()
        self.depth = len(convolutions)
        self.relu = nn.ReLU(inplace=True)
        into, total_stride = incoming, 1
        for number, (width, kernel, stride) in enumerate(convolutions, 1):
            self.add_module(f"conv{number}", nn.Conv2d(into, width, kernel, stride, kernel // 2, bias=False))
            self.add_module(f"bn{number}", norm_layer(norm, width, _GROUPS))
            into, total_stride = width, total_stride * stride
        self.downsample: nn.Module | None = None
        if total_stride != 1 or incoming != into:
            shortcut = nn.Conv2d(incoming, into, 1, total_stride, bias=False)
            self.downsample = nn.Sequential(shortcut, norm_layer(norm, into, _GROUPS))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        branch = x
        for number in range(1, self.depth + 1):
            branch = self.get_submodule(f"bn{number}")(self.get_submodule(f"conv{number}")(branch))
            if number < self.depth:
                branch = self.relu(branch)
        added: torch.Tensor = self.relu(branch + (x if self.downsample is None else self.downsample(x)))
        return added


def _convolutions(name: str, width: int, stride: int) -> list[tuple[int, int, int]]:
    """The (channels, kernel, stride) of a block's branch: two 3x3, or a bottleneck of four times `width` outside."""
    if name == "resnet18":
        return [(width, 3, stride), (width, 3, 1)]
    return [(width, 1, 1), (width, 3, stride), (4 * width, 1, 1)]
