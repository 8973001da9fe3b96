"""What a training writes for TensorBoard, where somebody asked for it."""

from __future__ import annotations

from pathlib import Path

from tactile_loc.plugin import MissingLibraryError


class TrainingLog:
    """Writes a point an epoch to a folder that TensorBoard shows; without a folder, nothing."""

    def __init__(self, folder: str | None, epochs_done: int = 0) -> None:
        """Open the log; what it holds of epochs after `epochs_done`, from a run that was interrupted, is hidden.

        Raises MissingLibraryError when TensorBoard is not installed.
        """
        self._writer = None
        if folder is None:
            return
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise MissingLibraryError(
                "encoder.tensorboard needs the package tensorboard; install it with pip install tensorboard, or leave "
                "the option out"
            ) from error
        self._writer = SummaryWriter(Path(folder).expanduser(), purge_step=epochs_done + 1)

    def epoch(self, number: int, values: dict[str, float]) -> None:
        """Write the values of an epoch, counted from 1."""
        if self._writer is not None:
            for name, value in values.items():
                self._writer.add_scalar(name, value, number)
            self._writer.flush()

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()
