"""The recipe of the learned encoder, its presets, and the network's input."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812 - torch's own abbreviation
from numpy.typing import NDArray
from torch import nn

from tactile_loc.plugin import SensorGeometry
from tactile_loc.plugins.encoders.moco.backbones import BackboneName, Norm

Signal = Literal["binary", "depth"]


@dataclass(frozen=True)
class Recipe:
    """All settings that determine the trained network. The defaults train in minutes on two CPU cores.

    `signal` selects the network's input: the contact mask alone, or the contact mask and the penetration depth. In each
    epoch, `queries` touches are rendered and used `repeats` times with new noise, `batch` touches in each step. Keys
    are encoded again after `refresh` steps. `momentum` is the momentum of the key network's weights. `temperature`
    (unitless) divides the similarities. `image_px` is the longer side of the input.
    """

    backbone: BackboneName = "small"
    channels: int = 16
    norm: Norm = "group"
    signal: Signal = "depth"
    image_px: int = 64
    epochs: int = 20
    queries: int = 3072
    repeats: int = 4
    batch: int = 256
    optimizer: Literal["adamw", "sgd"] = "adamw"
    rate: float = 2e-3
    weight_decay: float = 1e-4
    momentum: float = 0.98
    temperature: float = 0.07
    refresh: int = 24
    noise: str = "strong"
    patience: int = 8
    seed: int = 0

    def planes(self, partly_seen: bool) -> int:
        """Return the number of planes of the network's input, for shapes that are wholly or `partly_seen`."""
        return (3 if self.signal == "depth" else 2) + partly_seen

    def bytes_needed(self, poses: int) -> int:
        """Estimate the memory, bytes, of a training step with a grid of `poses` poses."""
        scores = 4 * 4 * self.batch * poses  # float32: scores, their exponentials, and the gradients of both
        keys = 2 * 4 * self.channels * 64 * poses
        return scores + keys

    def embed(
        self,
        network: nn.Module,
        depth_m: torch.Tensor,
        press_m: NDArray[np.float64],
        geometry: SensorGeometry,
        seen: NDArray[np.bool_] | None = None,
    ) -> torch.Tensor:
        """Return unit vectors (N, D) of contact depths (N, H, W), metres, cut at press depths (N,), metres.

        `seen` (N, H, W) marks the known pixels. It is given for networks with an input plane of known pixels.
        """
        planes, on_gpu = self.make_planes(depth_m, press_m, geometry, seen), depth_m.device.type == "cuda"
        if on_gpu:
            planes = planes.contiguous(memory_format=torch.channels_last)
        with torch.autocast(depth_m.device.type, torch.bfloat16, enabled=on_gpu):
            return F.normalize(network(planes).flatten(1), dim=1)

    def make_planes(
        self,
        depth_m: torch.Tensor,
        press_m: NDArray[np.float64],
        geometry: SensorGeometry,
        seen: NDArray[np.bool_] | None = None,
    ) -> torch.Tensor:
        """Return the network's input (N, P, h, w), 0 to 1, averaged to `image_px`, on the device of `depth_m`.

        The first plane is the observed contact mask. If the signal is "depth", the penetration follows. If `seen`
        (N, H, W) is given, the known pixels follow. The last plane is the press depth. Penetration and press depth are
        shares of the sensor's maximal depth.
        """
        device, deepest_m = depth_m.device, float(geometry.max_depth_m)
        press = torch.as_tensor(press_m, dtype=torch.float32, device=device)[:, None, None]
        known = torch.from_numpy(geometry.observed_mask if seen is None else seen & geometry.observed_mask).to(device)
        contact = (depth_m < press) & known
        planes = [contact.float()]
        if self.signal == "depth":
            planes.append(torch.where(contact, (press - depth_m) / deepest_m, 0.0))
        if seen is not None:
            planes.append(known.float())
        images = torch.stack(planes, dim=1)
        keeps_size = seen is not None and self.image_px < 2 * max(geometry.shape)
        small = geometry.shape if keeps_size else geometry.resize_long_side(self.image_px).shape
        images = images if images.shape[-2:] == small else F.interpolate(images, small, mode="area")
        return torch.cat([images, (press / deepest_m)[:, None].expand(-1, 1, *small)], dim=1)


PRESETS = {
    "cpu": Recipe(),
    # the paper's network and optimiser, for a GPU
    "paper": Recipe(
        backbone="resnet50",
        channels=64,
        norm="batch",
        signal="binary",
        image_px=200,
        epochs=30,
        queries=5120,
        repeats=4,
        batch=128,
        optimizer="sgd",
        rate=0.03,
        momentum=0.99,
        refresh=40,
    ),
}
