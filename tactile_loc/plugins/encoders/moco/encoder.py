"""The paper's learned encoder: an embedding of one object's contact shapes, learned by contrast in simulation.

A query is a newly rendered random touch. The queue is fixed: it has one key for each grid pose. The label of a query is
the grid pose nearest to the true pose. The loss is the cross-entropy of the softmax of similarities over the whole grid
(Bauza et al., CoRL 2020, after He et al., CVPR 2020). A momentum copy of the network encodes the keys from contact
shapes without noise.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
import psutil
import torch
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from tactile_loc.plugin import (
    Capabilities,
    ComponentOptions,
    ConfigError,
    Encoder,
    Float32,
    GridError,
    SensorGeometry,
    TrainingProblem,
    WeightsError,
)
from tactile_loc.plugin.helpers import NoiseLevel
from tactile_loc.plugins.encoders.moco.backbones import Backbone, BackboneName, make_backbone
from tactile_loc.plugins.encoders.moco.recipe import PRESETS, Recipe, Signal
from tactile_loc.plugins.encoders.moco.training import Trainer

PLANES = "planes"  # key of the number of input planes in the weights file
# preset "cpu" for a grid of places: small steps learn faster
PLACES: dict[str, Any] = {"batch": 64, "queries": 1024, "epochs": 8}
NEUTRAL: dict[str, JsonValue] = {"neutral": True}


class MocoEncoder(Encoder):
    """Encodes contact shapes by a trained network. Embeddings are unit vectors, so a score is the cosine minus one.

    Training is reproducible, bit for bit, with the same number of threads (OMP_NUM_THREADS) and the same kind of
    device: torch's order of summation depends on both.
    """

    capabilities = Capabilities(needs_training=True, deterministic=False)

    class Options(ComponentOptions):
        """A preset, and changes to it (None keeps the preset's value)."""

        preset: Literal["cpu", "paper"] = Field(default="cpu", description="cpu: minutes on 2 cores; paper: for a GPU")
        backbone: BackboneName | None = Field(default=None, description="the network")
        channels: int | None = Field(default=None, ge=1, le=2048, description="channels of the map kept as the vector")
        signal: Signal | None = Field(default=None, description="the contact mask only, or the depth as well")
        epochs: int | None = Field(default=None, ge=1, description="epochs, each with new touches")
        queries: int | None = Field(default=None, ge=32, description="touches rendered in each epoch")
        batch: int | None = Field(default=None, ge=2, description="touches in each step")
        rate: float | None = Field(default=None, gt=0, description="highest learning rate")
        noise: NoiseLevel = Field(default="strong", description="noise of the training touches")
        patience: int = Field(default=8, ge=1, description="epochs without a better validation before stopping early")
        seed: int = Field(default=0, ge=0, description="seed of the training")
        device: Literal["auto", "cpu", "cuda"] = Field(
            default="auto", description="where to compute", json_schema_extra=NEUTRAL
        )

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        chosen = self.options.model_dump(
            include={"backbone", "channels", "signal", "epochs", "queries", "batch", "rate"}
        )
        changes = {name: value for name, value in chosen.items() if value is not None}
        always = self.options.model_dump(include={"noise", "patience", "seed"})
        self.recipe: Recipe = replace(PRESETS[self.options.preset], **changes, **always)
        self._network: Backbone | None = None

    def describe(self) -> dict[str, Any]:
        """Return everything that determines the encoder's output, as JSON values: the recipe, but not the device."""
        return {**super().describe(), "recipe": asdict(self.recipe)}

    @property
    def device(self) -> torch.device:
        """The device to compute on. Raises ConfigError when CUDA is requested but absent."""
        wanted = self.options.device
        if wanted == "cuda" and not torch.cuda.is_available():
            raise ConfigError(
                "the encoder 'moco' cannot use CUDA, because torch finds no CUDA device; install a CUDA build of torch "
                "and a driver, or set encoder.device to cpu"
            )
        if wanted == "cpu" or not torch.cuda.is_available():
            return torch.device("cpu")
        return torch.device("cuda")

    def fit(self, problem: TrainingProblem) -> None:
        """Train on simulated touches.

        Raises GridError when the grid is too large for the memory, TrainingError when the loss becomes NaN in the first
        epoch, and ConfigError when CUDA is requested but absent.
        """
        _require_memory(self.recipe, len(problem))
        _reset_threads()
        recipe, options = self.recipe, self.options
        if problem.partly_seen and options.preset == "cpu":
            recipe = replace(
                recipe, **{name: value for name, value in PLACES.items() if getattr(options, name) is None}
            )
        network = self._make_network(options.seed, problem.partly_seen)
        trainer = Trainer(recipe, problem, network, self.device)
        self._network = trainer.run()

    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return unit embeddings (N, D) of contact depths (N, H, W), metres, cut at `press_depth_m`."""
        return self._encode(depth_m, np.ones(depth_m.shape, np.bool_), press_depth_m, geometry)

    def encode_seen(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return unit embeddings (N, D) of the `seen` pixels (N, H, W) of contact depths, and weights (N, D), all one.

        A network that was trained on partly seen touches gets the mask. For any other network, unseen pixels count as
        no contact.
        """
        press = np.float32(press_depth_m)
        embeddings = self._encode(np.where(seen, depth_m, press), seen, press_depth_m, geometry)
        return embeddings, np.ones_like(embeddings)

    def _encode(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> Float32:
        network = self._require_trained()
        _reset_threads()
        known = seen if network.in_channels == self.recipe.planes(partly_seen=True) else None
        press = np.full(len(depth_m), press_depth_m)
        with torch.inference_mode():
            vectors = self.recipe.embed(network, torch.from_numpy(depth_m).to(self.device), press, geometry, known)
        return vectors.float().cpu().numpy()

    def save_weights(self, path: Path) -> None:
        """Write the trained network to a safetensors file."""
        from safetensors.torch import save_file

        state = self._require_trained().state_dict()
        tensors = {k: v.detach().cpu().contiguous() for k, v in state.items()}
        save_file(tensors, path, {PLANES: str(self._require_trained().in_channels)})

    def load_weights(self, path: Path) -> None:
        """Read a trained network. Raises WeightsError when the file is damaged or of another architecture."""
        from safetensors import SafetensorError, safe_open

        try:
            with safe_open(path, framework="pt") as file:
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
                planes = (file.metadata() or {}).get(PLANES)
            network = self._make_network(0, partly_seen=planes == str(self.recipe.planes(partly_seen=True)))
            network.load_state_dict(tensors)
        except (SafetensorError, RuntimeError, OSError) as error:
            reason = str(error).splitlines()[0]
            raise WeightsError(
                f"{path} cannot be read as the weights of a {self.recipe.backbone} encoder ({reason}); train it again"
            ) from error
        self._network = network.to(self.device).eval()

    def _require_trained(self) -> Backbone:
        if self._network is None:
            raise ConfigError("the encoder 'moco' has not been trained for this object; build its model first")
        return self._network

    def _make_network(self, seed: int, partly_seen: bool) -> Backbone:
        recipe, generator = self.recipe, torch.Generator().manual_seed(seed)
        return make_backbone(recipe.backbone, generator, recipe.planes(partly_seen), recipe.channels, recipe.norm)


def _reset_threads() -> None:
    """Restore torch's original number of threads, because torch's sums depend on this number.

    When numba starts its threads, it changes OpenMP's number of threads, and thereby torch's, in the calling thread.
    Here, numba starts in an unused thread. Torch then gets the number of threads that a new thread has.
    """
    with ThreadPoolExecutor(1) as unused:
        threads = unused.submit(torch.get_num_threads).result()
        unused.submit(numba.get_num_threads).result()
    torch.set_num_threads(threads)


def _require_memory(recipe: Recipe, poses: int) -> None:
    """Raise GridError when scores and keys do not fit into the machine's memory."""
    needed, free = recipe.bytes_needed(poses), psutil.virtual_memory().available
    if needed > 0.8 * free:
        raise GridError(
            f"training on {poses} poses needs about {needed / 2**30:.1f} GiB of memory, but {free / 2**30:.1f} are "
            "free; set a smaller encoder.batch, or a larger grid.spacing_mm"
        )
