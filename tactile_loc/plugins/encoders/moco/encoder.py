"""The paper's learned encoder: an embedding of one object's contact shapes, learned by contrast, in simulation only.

A query is a freshly rendered random touch; the queue is fixed, one key a grid pose; the label is the nearest grid pose;
the loss is the cross-entropy of the softmax of similarities over the whole grid (Bauza et al., CoRL 2020, after He et
al., CVPR 2020). The keys are encoded from clean shapes by a momentum copy of the network, again as training goes on.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
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
    NoiseLevel,
    SensorGeometry,
    TrainingProblem,
    WeightsError,
)
from tactile_loc.plugins.encoders.moco.backbones import Backbone, load_pretrained, make_backbone
from tactile_loc.plugins.encoders.moco.recipe import PRESETS, Recipe, Signal
from tactile_loc.plugins.encoders.moco.training import Trainer, find_local_cuda

PLANES = "planes"  # how many the input has, in the file of weights; without it, those of shapes that are wholly seen
SMALLER = 4  # times smaller is a batch of touches that places are learned from: more and lighter steps learn faster
NEUTRAL: dict[str, JsonValue] = {"neutral": True}


class MocoEncoder(Encoder):
    """Learns in `fit`; unit vectors, whose score in a matcher is the cosine minus one.

    On as many threads (OMP_NUM_THREADS) and on the same kind of device it learns the same, to the bit; on others not:
    torch adds up in an order that depends on them.
    """

    capabilities = Capabilities(needs_training=True, deterministic=False)

    class Options(ComponentOptions):
        """A preset, and what differs from it (None: as the preset has it)."""

        preset: Literal["cpu", "paper"] = Field(default="cpu", description="cpu: minutes on 2 cores; paper: for a GPU")
        backbone: Literal["small", "resnet18", "resnet50"] | None = Field(default=None, description="the network")
        channels: int | None = Field(default=None, ge=1, le=2048, description="channels of the map kept as the vector")
        signal: Signal | None = Field(default=None, description="the contact mask alone, or the depth as well")
        epochs: int | None = Field(default=None, ge=1, description="epochs, each of fresh touches")
        queries: int | None = Field(default=None, ge=32, description="touches rendered an epoch")
        batch: int | None = Field(default=None, ge=2, description="touches a step")
        rate: float | None = Field(default=None, gt=0, description="learning rate at its highest")
        noise: NoiseLevel = Field(default="strong", description="noise of the touches to learn from")
        negatives: int = Field(
            default=0, ge=0, description="grid poses in the softmax a step, drawn; 0: the whole grid"
        )
        decoys: int = Field(
            default=0, ge=0, le=15, description="of a whole object: views of each touch that is turned wrongly"
        )
        patience: int = Field(default=8, ge=1, description="epochs without a better validation before stopping early")
        seed: int = Field(default=0, ge=0, description="of all that is drawn in training")
        pretrained: str | None = Field(default=None, description="weights to start from, a .safetensors file")
        device: Literal["auto", "cpu", "cuda"] = Field(
            default="auto", description="where to compute", json_schema_extra=NEUTRAL
        )
        tensorboard: str | None = Field(
            default=None, description="folder for a TensorBoard log of the training", json_schema_extra=NEUTRAL
        )

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        chosen = self.options.model_dump(
            include={"backbone", "channels", "signal", "epochs", "queries", "batch", "rate"}
        )
        changes = {name: value for name, value in chosen.items() if value is not None}
        self.recipe: Recipe = PRESETS[self.options.preset].change(
            **changes,
            noise=self.options.noise,
            negatives=self.options.negatives,
            patience=self.options.patience,
            seed=self.options.seed,
        )
        self._network: Backbone | None = None

    def describe(self) -> dict[str, Any]:
        """Return what identifies the encoder's output: the whole recipe, not where it is computed."""
        described = super().describe()
        if not self.options.decoys:
            del described["options"]["decoys"]  # so what was learned before there were any is found
        return {**described, "recipe": self.recipe.describe()}

    @property
    def device(self) -> torch.device:
        """Where to compute. Raises ConfigError when CUDA is asked for and absent."""
        wanted = self.options.device
        if wanted == "cuda" and not torch.cuda.is_available():
            raise ConfigError(
                "the encoder 'moco' was asked to run on CUDA, but torch sees no CUDA device here; install a CUDA "
                "build of torch and a driver, or set encoder.device to cpu"
            )
        return find_local_cuda() if wanted != "cpu" and torch.cuda.is_available() else torch.device("cpu")

    def fit(self, problem: TrainingProblem) -> None:
        """Train on simulated touches, together with the other processes if torchrun started several.

        Raises GridError for a grid too large for memory, WeightsError, ConfigError, MissingLibraryError.
        """
        _require_memory(self.recipe, len(problem))
        _reset_threads()
        recipe, options = self.recipe, self.options
        if problem.partly_seen and options.batch is None:
            recipe = recipe.change(batch=max(2, recipe.batch // SMALLER))
        network = self._make_network(options.seed, problem.partly_seen)
        trainer = Trainer(recipe, problem, network, self.device, options.tensorboard, options.decoys)
        self._network = trainer.run()

    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return unit embeddings (N, D) of contact depths (N, H, W) in metres cut at `press_depth_m`."""
        return self._encode(depth_m, np.ones(depth_m.shape, np.bool_), press_depth_m, geometry)

    def encode_seen(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return unit embeddings (N, D) of what is `seen` (N, H, W) of contact depths, and weights (N, D), all one.

        A network that learned from touches that are partly seen knows what is not seen; to another it is no contact.
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
            vectors = self.recipe.embed(network, depth_m, press, geometry, self.device, known)
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

        whole, partly = (self.recipe.planes(partly_seen) for partly_seen in (False, True))
        try:
            with safe_open(path, framework="pt") as file:
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
                planes = (file.metadata() or {}).get(PLANES, str(whole))
            network = self._make_network(0, planes == str(partly), pretrained=False)
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

    def _make_network(self, seed: int, partly_seen: bool, pretrained: bool = True) -> Backbone:
        recipe = self.recipe
        network = make_backbone(
            recipe.backbone, generator=torch.Generator().manual_seed(seed), in_channels=recipe.planes(partly_seen),
            channels=recipe.channels, norm=recipe.norm,
        )  # fmt: skip
        if pretrained and self.options.pretrained:
            load_pretrained(network, self.options.pretrained)
        return network


def _reset_threads() -> None:
    """Let torch compute with its own number of threads, whatever ran before: the sums depend on it.

    When numba starts its threads, it sets OpenMP's number of threads, and so torch's, for the thread that it is called
    from. Here it starts in a thread of no other use, and torch gets the number back that a new thread has.
    """
    with ThreadPoolExecutor(1) as unused:
        threads = unused.submit(torch.get_num_threads).result()
        unused.submit(numba.get_num_threads).result()
    torch.set_num_threads(threads)


def _require_memory(recipe: Recipe, poses: int) -> None:
    """Raise GridError when scores and keys would not fit into the machine's memory."""
    needed, free = recipe.bytes_needed(poses), _find_available_bytes()
    if needed > 0.8 * free:
        raise GridError(
            f"training on {poses} poses needs about {needed / 2**30:.1f} GiB of memory, {free / 2**30:.1f} are free; "
            "set encoder.negatives (16384, say) or a smaller encoder.batch, or a coarser grid.spacing_mm"
        )


def _find_available_bytes() -> int:
    """Memory that programs can still get: what Linux says, elsewhere all there is."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))
