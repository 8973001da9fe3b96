"""One visitor's calibration of a sensor: the uploaded photos, and the sensor that is made from them."""

import logging
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from tactile_loc import (
    IMAGE_SUFFIXES,
    VIDEO_SUFFIXES,
    CalibrationOutcome,
    EstimatorRecipe,
    LabelledFolder,
    StageStore,
    TactileLocError,
    calibrate_folder,
    label_presses,
    list_named_files,
    read_photo,
    save_held_out,
    save_labels,
)
from tactile_loc.commands import list_files

from tactile_loc_app.errors import AppError
from tactile_loc_app.page.task_progress import ShowProgress, TaskProgress
from tactile_loc_app.uploads import read_files, write_upload

logger = logging.getLogger("tactile_loc.app")

PHOTOS = "photos"
TABLE, SENSOR, SHEET = "presses.csv", "sensor.toml", "labels.png"  # files of a folder of presses
SUFFIXES = (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES, PurePath(TABLE).suffix)


@dataclass(frozen=True, eq=False)
class MadeSensor:
    """A calibrated sensor in its `folder`, and the `labelled` folder of presses from which it was made."""

    folder: Path
    labelled: LabelledFolder
    outcome: CalibrationOutcome

    def describe(self) -> list[str]:
        """Return the key facts as sentences: doubts, the photos, the gel, and the errors on held-out photos."""
        made, photos = self.outcome, self.labelled.describe()
        errors = [f"{made.title}; mean errors on these:", *(f"  {line}" for line in made.list_errors())]
        return [*self.labelled.list_doubts(), *made.doubts, *photos, *made.facts, *errors]

    def pack(self) -> bytes:
        """Return a zip archive of the calibration folder, and of the labels from which it was made."""
        with tempfile.TemporaryDirectory() as temporary:
            root = Path(temporary) / "archive"
            shutil.copytree(self.folder, root / self.folder.name)
            labels = root / f"{self.folder.name}-labels"
            labels.mkdir()
            for name in (TABLE, SENSOR, SHEET):
                if (self.labelled.folder / name).is_file():
                    shutil.copyfile(self.labelled.folder / name, labels / name)
            return Path(shutil.make_archive(str(root), "zip", root)).read_bytes()


class Calibrator:
    """Keeps photos in `folder`, and makes sensors from them. Each calibration has an own folder.

    `reference` is the name of the photo of the untouched gel, if one was given. `options` are those of the estimator.
    """

    def __init__(self, folder: Path, store: StageStore, options: dict[str, Any] | None = None) -> None:
        self.folder, self.store, self.options = folder, store, options or {}
        self.reference: str | None = None
        self.made: MadeSensor | None = None
        self._stopped = False
        self._photos = folder / PHOTOS
        self._photos.mkdir(parents=True)

    @property
    def names(self) -> list[str]:
        """The names of the photos and videos of presses, and of the table if there is one."""
        return [path.name for path in list_files(self._photos, SUFFIXES) if path.name != self.reference]

    def set_reference(self, name: str, content: bytes) -> None:
        """Take the photo of the untouched gel, instead of an earlier one. Raises TactileLocError if it is none."""
        with tempfile.TemporaryDirectory(dir=self.folder) as temporary:
            path = write_upload(Path(temporary), name, content)
            _require_photo(path)
            if path.name in self.names:
                raise AppError(f"there is a photo {path.name} of a press already; give this photo another name")
            if self.reference is not None:
                (self._photos / self.reference).unlink()
            self.reference = path.replace(self._photos / path.name).name

    def add_photos(self, name: str, content: bytes) -> list[str]:
        """Add a photo, a video, a table presses.csv, or a zip archive of these, and return the names of the files.

        A file of the same name is replaced. Unusable files of an archive are left out, with a warning. Raises
        TactileLocError if no file can be used.
        """
        with tempfile.TemporaryDirectory(dir=self.folder) as temporary:
            added, faults = list[Path](), list[TactileLocError]()
            for path, data in read_files(name, content):
                if path.name in {other.name for other in added}:
                    raise AppError(f"{name} holds two files {path.name}; give each photo its own name")
                if path.name == SHEET:
                    continue
                try:
                    written = write_upload(Path(temporary), path.name, data)
                    self._require_usable(written)
                except TactileLocError as fault:
                    faults.append(fault)
                else:
                    added.append(written)
            if faults and not added:
                raise faults[0]
            if faults:
                logger.warning("files left out of %s: %d, because %s", name, len(faults), faults[0])
            return [path.replace(self._photos / path.name).name for path in added]

    def _require_usable(self, path: Path) -> None:
        """Raise TactileLocError unless a file is a photo, a video, or a table that names no other folder."""
        suffix = path.suffix.lower()
        if path.name == TABLE:
            other = next((name for name in list_named_files(path) if PurePath(name).name != name), None)
            if other is not None:
                raise AppError(f"{TABLE} names the file {other!r}; give only the names of uploaded photos")
        elif path.name == self.reference:
            raise AppError(f"{path.name} is the photo of the untouched gel; give the photo of a press another name")
        elif suffix in IMAGE_SUFFIXES:
            _require_photo(path)
        elif suffix not in VIDEO_SUFFIXES:
            raise AppError(f"{path.name} is neither a photo, nor a video, nor {TABLE}; leave it out")

    def remove_photo(self, name: str) -> None:
        """Remove one file of `names`, or the reference. Raises AppError if there is no such file."""
        if name not in (*self.names, self.reference):
            raise AppError(f"there is no photo {name!r}; choose one of the list")
        (self._photos / name).unlink()
        if name == self.reference:
            self.reference = None

    def clear(self) -> None:
        """Remove all photos. A sensor that was made from them stays."""
        self.reference = None
        for path in list_files(self._photos, SUFFIXES):
            path.unlink()

    def stop(self) -> None:
        """End a running calibration at its next step."""
        self._stopped = True

    def calibrate(
        self, name: str, ball_radius_mm: float, mm_per_px: float, show: ShowProgress | None = None
    ) -> MadeSensor:
        """Make the sensor `name` from the photos of a ball, as the command line does, and keep it as `made`.

        `show` gets the running task and its share, 0 to 1. Raises TactileLocError for unusable photos or lengths.
        """
        if not self.names:
            raise AppError("there is no photo of a press yet; upload photos of the pressed ball first")
        if not name or PurePath(name).name != name or name.startswith(".") or not name.isprintable():
            raise AppError(f"a sensor cannot be called {name!r}; give a name of letters and numbers")
        progress = TaskProgress(show, lambda: not self._stopped)
        work = Path(tempfile.mkdtemp(dir=self.folder, prefix="made-"))
        presses = work / PHOTOS
        shutil.copytree(self._photos, presses)
        labelled = label_presses(presses, None, ball_radius_mm, mm_per_px, progress)
        self._require_untouched(labelled)
        recipe = EstimatorRecipe(options=self.options)
        outcome = calibrate_folder(labelled.folder, labelled.sensor, recipe, store=self.store, progress=progress)
        made = MadeSensor(outcome.write(work / name), labelled, outcome)
        save_held_out(made.folder, outcome)
        if labelled.found is not None:
            save_labels(labelled.folder, labelled.found)
        self.made = made
        return made

    def _require_untouched(self, labelled: LabelledFolder) -> None:
        """Raise AppError if the photo of the untouched gel shows a press."""
        found = labelled.found
        if found is None or self.reference is None or self.reference in found.untouched_names:
            return
        raise AppError(
            f"{self.reference} differs from the untouched gel in the other photos; take it without contact, with the "
            "same light"
        )


def _require_photo(path: Path) -> None:
    try:
        read_photo(path)
    except TactileLocError as error:
        raise AppError(str(error).replace(str(path), path.name)) from error
