"""Training of the learned encoder."""

import copy
import json
import logging
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812 - torch's own abbreviation
from torch import nn

from tactile_loc.plugin import TrainingBatch, TrainingError, TrainingProblem, TrainingTouches
from tactile_loc.plugin.helpers import make_noise
from tactile_loc.plugins.encoders.moco.backbones import Backbone
from tactile_loc.plugins.encoders.moco.recipe import Recipe

log = logging.getLogger(__name__)

T = TypeVar("T")

VALIDATION_TOUCHES = 256
VALIDATION_PRESSES = 4
KEYS_AT_ONCE = 512
BATCHES_AHEAD = 8  # batches that threads prepare on a machine with a GPU, while the network learns


def work_ahead(make: Callable[[int], T], numbers: Iterable[int], threads: int) -> Iterator[T]:
    """Yield `make(number)` in order. Threads compute the next results while the caller uses the last one."""
    with ThreadPoolExecutor(threads) as pool:
        coming: deque[Future[T]] = deque()
        for number in numbers:
            coming.append(pool.submit(make, number))
            if len(coming) > threads:
                yield coming.popleft().result()
        while coming:
            yield coming.popleft().result()


class Trainer:
    """Trains a network on a problem.

    The random numbers of an epoch depend only on the recipe's seed and the epoch's number. A resumed training therefore
    gives the same result as an uninterrupted training.
    """

    def __init__(self, recipe: Recipe, problem: TrainingProblem, network: Backbone, device: torch.device) -> None:
        self.recipe, self.problem, self.device = recipe, problem, device
        self.network = network.to(device)
        self.key_network = copy.deepcopy(self.network).requires_grad_(False)
        self.optimizer = _make_optimizer(recipe, self.network)
        self.noise = make_noise(recipe.noise)
        self.batch = min(recipe.queries, recipe.batch)
        self.steps = recipe.repeats * max(1, recipe.queries // recipe.batch)
        self.epoch, self.best, self.stale = 0, math.inf, 0
        self.best_weights = _copy_weights(self.network)
        self.kept_shapes: dict[float, list[torch.Tensor]] = {}

    def run(self) -> Backbone:
        """Train from the last checkpoint, if any, and return the network with the lowest validation loss.

        The network is in evaluation mode. Raises TrainingError when the loss becomes NaN in the first epoch. If the
        loss becomes NaN in a later epoch, the training stops.
        """
        self._resume()
        self._run_epochs(self._render(VALIDATION_TOUCHES, 0, 1))
        self.network.load_state_dict(self.best_weights)
        return self.network.eval()

    def _run_epochs(self, validation: TrainingTouches) -> None:
        with self.problem.progress.task("training the encoder", self.recipe.epochs) as advance:
            advance(self.epoch)
            for queries in work_ahead(self._render_epoch, range(self.epoch, self.recipe.epochs), 1):
                loss = self._train_epoch(queries)
                if not math.isfinite(loss):
                    self._stop_at_nan()
                    break
                self._judge(loss, validation)
                self._checkpoint()
                advance(1)
                if self.stale >= self.recipe.patience:
                    log.info("stopped early: no better validation for %d epochs", self.stale)
                    break

    def _render_epoch(self, epoch: int) -> TrainingTouches:
        """Render an epoch's touches."""
        return self._render(self.recipe.queries, epoch, 0, 0)

    def _render(self, count: int, *seed: int) -> TrainingTouches:
        return self.problem.draw(count, self.noise, np.random.default_rng([self.recipe.seed, *seed]))

    def _train_epoch(self, queries: TrainingTouches) -> float:
        """Train one epoch. Return the mean loss (unitless), or NaN as soon as a step's loss is NaN."""
        self.network.train()
        losses: list[float] = []
        threads = BATCHES_AHEAD if self.device.type == "cuda" else 1
        batches = work_ahead(partial(self._make_batch, queries), range(self.steps), threads)
        for step, batch in enumerate(batches):
            if step == self._find_refresh(step):
                keys = self._keys(self.key_network, self._draw_press(step))
            loss = self._step(batch, keys, step)
            losses.append(loss)
            if not math.isfinite(loss):
                return math.nan
        self.epoch += 1
        return float(np.mean(losses))

    def _make_batch(self, queries: TrainingTouches, step: int) -> TrainingBatch:
        """Return the touches of a step, with new noise."""
        rng = np.random.default_rng([self.recipe.seed, self.epoch, 2, 0, step])
        return queries.batch(self.batch, rng, self._draw_press(self._find_refresh(step)))

    def _find_refresh(self, step: int) -> int:
        """Return the last step, up to `step`, before which the keys are encoded again."""
        return step - step % self.recipe.refresh

    def _draw_press(self, step: int) -> float:
        """Draw the press depth, metres, at which touches and keys are compared from this step on."""
        presses_m = self.problem.key_presses_m
        rng = np.random.default_rng([self.recipe.seed, self.epoch, 4, step])
        return float(presses_m[0] if len(presses_m) == 1 else rng.choice(presses_m))

    def _step(self, batch: TrainingBatch, keys: torch.Tensor, step: int) -> float:
        for group in self.optimizer.param_groups:
            group["lr"] = self._rate(self.epoch + step / self.steps)
        vectors = self._embed(batch)
        targets = torch.from_numpy(batch.labels).to(self.device)
        loss = F.cross_entropy(self._scores(vectors, keys), targets)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        follow(self.key_network, self.network, self.recipe.momentum)
        return float(loss.detach())

    def _rate(self, epochs_done: float) -> float:
        """Return the learning rate: it rises for half an epoch, then falls along a cosine to a hundredth."""
        warm = min(1.0, epochs_done / 0.5 + 0.02)
        return self.recipe.rate * warm * (0.505 + 0.495 * math.cos(math.pi * epochs_done / self.recipe.epochs))

    def _embed(self, batch: TrainingBatch) -> torch.Tensor:
        """Return the unit vectors (B, D) of a batch's touches."""
        known = batch.seen if self.problem.partly_seen else None
        shapes = torch.from_numpy(batch.depth_m).to(self.device)
        return self.recipe.embed(self.network, shapes, batch.press_m, self.problem.geometry, known)

    def _scores(self, vectors: torch.Tensor, keys: torch.Tensor) -> torch.Tensor:
        """Return the similarity (B, N) of each touch to each of N keys."""
        return vectors.float() @ keys.T / self.recipe.temperature

    @torch.no_grad()
    def _keys(self, network: nn.Module, press_m: float) -> torch.Tensor:
        """Encode the keys (N, D) from shapes without noise, cut at a press depth, metres."""
        problem, training = self.problem, network.training
        network.eval()
        rows = []
        for shard in self._key_shapes(press_m):
            for part in torch.tensor_split(shard, -(-len(shard) // KEYS_AT_ONCE)):
                known = np.ones(part.shape, np.bool_) if problem.partly_seen else None
                vectors = self.recipe.embed(network, part, np.full(len(part), press_m), problem.geometry, known)
                rows.append(vectors.float())
        network.train(training)
        return torch.cat(rows)

    def _key_shapes(self, press_m: float) -> Iterable[torch.Tensor]:
        """Return the keys' contact depths (S, H, W), metres, in shards on the device. A GPU keeps them if they fit."""
        problem = self.problem
        if press_m in self.kept_shapes:
            return self.kept_shapes[press_m]
        shapes = (torch.from_numpy(shard).to(self.device) for shard in problem.clean_keys(press_m))
        if self.device.type == "cuda":
            needed = 4 * math.prod(problem.geometry.shape) * len(problem) * len(problem.key_presses_m)
            if needed < torch.cuda.mem_get_info(self.device)[0] / 4 or self.kept_shapes:
                return self.kept_shapes.setdefault(press_m, list(shapes))
        return shapes

    @torch.no_grad()
    def _validate(self, validation: TrainingTouches) -> tuple[float, float]:
        """Return the loss (unitless) and the median distance, metres, of the best key's pose from the label's pose."""
        self.network.eval()
        rng = np.random.default_rng([self.recipe.seed, 3])
        presses_m = self.problem.key_presses_m
        some_m = presses_m[np.linspace(0, len(presses_m) - 1, min(len(presses_m), VALIDATION_PRESSES)).astype(int)]
        losses, errors_m = [], []
        for press_m in some_m:
            batch = validation.batch(len(validation) // len(some_m), rng, press_m)
            keys = self._keys(self.network, press_m)
            scores = self._scores(self._embed(batch), keys)
            losses.append(float(F.cross_entropy(scores, torch.from_numpy(batch.labels).to(self.device))))
            found = scores.argmax(dim=1).cpu().numpy()
            errors_m.append(self.problem.key_distances(found, batch.labels))
        return float(np.mean(losses)), float(np.median(np.concatenate(errors_m)))

    def _judge(self, loss: float, validation: TrainingTouches) -> None:
        """Keep the network if its validation loss is the lowest so far.

        The loss decides, because it varies less from epoch to epoch than the pose error.
        """
        validation_loss, error_m = self._validate(validation)
        shown = f"loss {loss:.2f}, validation loss {validation_loss:.2f}, validation best-1 {error_m * 1e3:.2f} mm"
        self.problem.progress.note(shown)
        log.info("epoch %d: %s", self.epoch, shown)
        if validation_loss < self.best:
            self.best, self.stale, self.best_weights = validation_loss, 0, _copy_weights(self.network)
        else:
            self.stale += 1

    def _stop_at_nan(self) -> None:
        advice = "lower encoder.rate"
        if self.epoch == 0:
            raise TrainingError(f"the loss became NaN in the first epoch of training; {advice}")
        log.warning("the loss became NaN in epoch %d; the best earlier network is kept; %s", self.epoch + 1, advice)

    def _checkpoint(self) -> None:
        from safetensors.torch import save_file

        parts = {"best": self.best_weights, "network": self.network.state_dict(), "key": self.key_network.state_dict()}
        parts |= {f"optimizer.{number}": state for number, state in self.optimizer.state_dict()["state"].items()}
        tensors = {
            f"{part}.{name}": torch.as_tensor(value).detach().cpu().clone().contiguous()
            for part, state in parts.items()
            for name, value in state.items()
            if value is not None
        }
        progress = {"epoch": self.epoch, "best": self.best, "stale": self.stale}
        self.problem.checkpoints.save(lambda path: save_file(tensors, path, {"progress": json.dumps(progress)}))

    def _resume(self) -> None:
        path = self.problem.checkpoints.load()
        if path is None:
            return
        tensors, progress = _read_checkpoint(path)
        self.epoch, self.best, self.stale = progress["epoch"], progress["best"], progress["stale"]
        self.best_weights = _select_prefixed(tensors, "best.")
        self.network.load_state_dict(_select_prefixed(tensors, "network."))
        self.key_network.load_state_dict(_select_prefixed(tensors, "key."))
        state: dict[int, dict[str, torch.Tensor]] = {}
        for name, tensor in _select_prefixed(tensors, "optimizer.").items():
            number, _, key = name.partition(".")
            state.setdefault(int(number), {})[key] = tensor
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": state})
        log.info("resumed training after epoch %d", self.epoch)


@torch.no_grad()
def follow(slow: nn.Module, fast: nn.Module, momentum: float) -> None:
    """Move the weights of the slow network towards those of the fast network, and copy the running statistics.

    The statistics matter, because keys are encoded in evaluation mode. Averaged statistics would fit neither network.
    """
    for weight, newer in zip(slow.parameters(), fast.parameters(), strict=True):
        weight.copy_(torch.lerp(newer, weight, momentum))
    for statistic, current in zip(slow.buffers(), fast.buffers(), strict=True):
        statistic.copy_(current)


def _make_optimizer(recipe: Recipe, network: nn.Module) -> torch.optim.Optimizer:
    if recipe.optimizer == "sgd":
        return torch.optim.SGD(network.parameters(), recipe.rate, momentum=0.9, weight_decay=recipe.weight_decay)
    return torch.optim.AdamW(network.parameters(), recipe.rate, weight_decay=recipe.weight_decay)


def _copy_weights(network: nn.Module) -> dict[str, torch.Tensor]:
    return {k: v.detach().cpu().clone() for k, v in network.state_dict().items()}


def _select_prefixed(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}


def _read_checkpoint(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        return {k: file.get_tensor(k) for k in file.keys()}, json.loads(file.metadata()["progress"])  # noqa: SIM118
