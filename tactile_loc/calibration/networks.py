"""Networks of the estimators as files."""

from __future__ import annotations

from pathlib import Path

from torch import nn

from tactile_loc.core.errors import WeightsError


def save_network(network: nn.Module, path: Path) -> None:
    """Write a network's weights to a safetensors file."""
    from safetensors.torch import save_file

    save_file({name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}, path)


def load_network(network: nn.Module, path: Path, name: str) -> None:
    """Read weights into a network. Raises WeightsError when the file is damaged or of another estimator."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        network.load_state_dict(load_file(path))
    except (SafetensorError, RuntimeError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise WeightsError(
            f"{path} cannot be read as the weights of a {name} estimator ({reason}); calibrate the sensor again"
        ) from error
