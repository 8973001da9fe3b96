"""The processes that train one encoder together: one a GPU under torchrun, else this one alone."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any, TypeVar

import torch
import torch.distributed as dist

from tactile_loc.plugin import rank

T = TypeVar("T")


class Crew:
    """What the processes of a training tell one another. `rank` of `size`; the first, 0, writes all that is kept.

    A crew of one sends nothing. Leave it when done.
    """

    def __init__(self, device: torch.device) -> None:
        """Join the processes that torchrun started, if it did; `device` is where tensors that are sent live."""
        self.size = int(os.environ.get("WORLD_SIZE", "1"))
        self.rank = rank()
        self.device = device
        if self.size > 1:
            dist.init_process_group("nccl" if device.type == "cuda" else "gloo")

    def leave(self) -> None:
        """Part, so that each process can end when it likes."""
        if self.size > 1:
            dist.destroy_process_group()

    def share(self, count: int) -> int:
        """Return how many of `count` things each process does, at least one."""
        return max(1, count // self.size)

    def average(self, tensors: Iterable[torch.Tensor]) -> None:
        """Put the mean over all processes into each tensor, which is (...) on every one of them."""
        if self.size > 1:
            for tensor in tensors:
                dist.all_reduce(tensor)
                tensor /= self.size

    def add(self, tensor: torch.Tensor) -> torch.Tensor:
        """Put the sum over all processes into a tensor (...), and return it."""
        if self.size > 1:
            dist.all_reduce(tensor)
        return tensor

    def agree(self, value: T) -> T:
        """Return what the first process says."""
        if self.size == 1:
            return value
        said: list[Any] = [value]
        dist.broadcast_object_list(said, device=self.device)
        return said[0]  # type: ignore[no-any-return]


def local_cuda() -> torch.device:
    """Return the GPU of this process: the one that torchrun numbered, else the first."""
    return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
