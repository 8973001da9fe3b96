"""A folder of meshes as a library, and `identification.json`, the result of an identification. SI units."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from tactile_loc.core.runtime.errors import ConfigError, ObjectError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.io.config import ObjectConfig, RunConfig
from tactile_loc.io.streams.records import Record
from tactile_loc.io.toml import Matrix
from tactile_loc.library.folder import MANIFEST, LibraryFolder
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.stored_object import list_mesh_files, load_stored_object
from tactile_loc.planning.next_touch import NextTouch
from tactile_loc.planning.next_touch_files import write_next_touch
from tactile_loc.store.store import StageStore
from tactile_loc.tasks.identify import LEAST_REPORTED, Identification
from tactile_loc.tasks.library import Library
from tactile_loc.tasks.library_parts import StoredParts

SCHEMA_VERSION = 1
NONE_OF_THESE = "none of these"
AS_PROBABLE = 0.7  # times the probability of the first object: such an object explains the touches as well


class PoseRecord(Record):
    """A pose of an object, assuming that this object was touched."""

    probability: float | None = Field(
        description="of this pose, given this object, 0 to 1; null: the object is too improbable to compute it"
    )
    T_sensor_object: Matrix = Field(description="(4, 4), m, in the first touch's sensor frame")
    imprint_iou: float = Field(description="how well it explains the touches, 0 to 1")


class KnownObjectRecord(Record):
    """One object of the library."""

    name: str = Field(description="the object's name")
    probability: float = Field(description="that the touches are of this object, 0 to 1")
    alike: float = Field(description="mean similarity of the touches and its places, at most 1; higher is more similar")
    rough_iou: float = Field(description="mean imprint IoU of a rough search, 0 to 1; 0 without a search")
    rough_misfit_nats: float | None = Field(
        default=None,
        description="the evidence that its best pose in a rough search lacks to explain the touches fully; null: none",
    )
    misfit_nats: float | None = Field(
        description="the evidence that its best pose lacks to explain the touches fully; null: it was not located",
    )
    poses: list[PoseRecord] = Field(description="its possible poses, the most probable first")


class IdentificationRecord(Record):
    """The whole file."""

    schema_version: int = Field(
        default=SCHEMA_VERSION, description="raised when a key is removed or changes its meaning"
    )
    touches: list[str] = Field(description="the touches that were identified")
    verdict: Verdict | None = Field(
        default=None, description="how far to trust the first object; null: the file has no verdict yet"
    )
    identified: str | None = Field(description="the object that they are of; null: none of these is more probable")
    none: float = Field(description="probability that they are of none of these objects, 0 to 1")
    objects: list[KnownObjectRecord] = Field(description="the library, the most probable first")
    next_touch: dict[str, Any] | None = Field(
        default=None, description="the rated approaches, as in next_touch.json; null: none was asked for"
    )

    @property
    def inseparable(self) -> list[str]:
        """The names of the objects that explain the touches as well as the first one; empty if there are none.

        It includes the first object. Each has at least AS_PROBABLE times its probability.
        """
        least = max(LEAST_REPORTED, AS_PROBABLE * self.objects[0].probability)
        names = [one.name for one in self.objects if one.probability >= least]
        return names if len(names) > 1 else []

    def summary(self) -> str:
        """Return the verdict and the probable objects, such as "ambiguous: hook 39 %, head 31 %"."""
        shares = [(NONE_OF_THESE, self.none), *((one.name, one.probability) for one in self.objects)]
        first, *others = sorted(shares, key=lambda share: -share[1])
        named = ", ".join(f"{name} {format_percent(p)}" for name, p in (first, *others) if p >= LEAST_REPORTED)
        why = "; the best pose does not explain the touches" if self.verdict == Verdict.POOR_FIT else ""
        if self.inseparable and self.identified is not None:
            why += f"; these touches cannot tell {' and '.join(self.inseparable)} apart"
        return f"{self.verdict or 'no verdict'}: {named or 'no object is probable'}{why}"


def read_library(folder: Path, config: RunConfig, store: StageStore, progress: Progress) -> Library:
    """Open a folder with a library of parts, or with meshes.

    `config` has all settings of the localizers except the object. Raises ObjectError if there is no such folder, or no
    mesh in it, and LibraryError if a library cannot be read.
    """
    if (folder / MANIFEST).exists():
        if config.object.model_copy(update={"path": ObjectConfig().path}) != ObjectConfig():
            raise ConfigError(f"{folder} is a library, which states units and symmetries; leave out both options")
        return Library(StoredParts(LibraryFolder.open(folder), config, store, progress))
    if not os.path.isdir(folder):
        raise ObjectError(f"there is no folder {folder}; give one with a mesh file for each object")
    models = []
    for path in list_mesh_files(folder):
        chosen = config.object.model_copy(update={"path": str(path)})
        obj = load_stored_object(path, chosen.units, chosen.symmetry, store)
        models.append(Localizer(config.model_copy(update={"object": chosen}), obj, store, progress))
    return Library(models)


def make_identification_record(
    found: Identification, touches: list[str], next_touch: NextTouch | None = None
) -> IdentificationRecord:  # fmt: skip
    """Make the record of an identification; `touches` are the touches' names."""
    return IdentificationRecord(
        touches=touches, verdict=found.verdict, identified=None if found.best is None else found.best.name,
        none=found.none, next_touch=None if next_touch is None else write_next_touch(next_touch),
        objects=[
            KnownObjectRecord(
                name=one.name, probability=one.probability, alike=one.alike, rough_iou=one.rough_iou,
                rough_misfit_nats=one.rough_misfit if np.isfinite(one.rough_misfit) else None,
                misfit_nats=one.misfit if np.isfinite(one.misfit) else None,
                poses=[
                    PoseRecord(
                        probability=h.probability if one.fitted else None,
                        T_sensor_object=h.T_sensor_object.tolist(), imprint_iou=h.imprint_iou,
                    )
                    for h in (one.found.hypotheses if one.found else ())
                ],
            )
            for one in found.objects
        ],
    )  # fmt: skip
