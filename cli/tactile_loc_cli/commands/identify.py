"""`tactile-loc identify`: find which of a few objects was touched, if any."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.core.runtime.errors import ConfigError, ObjectError
from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.commands.next_touch import DRAWN, WantedApproaches
from tactile_loc_cli.console import make_progress, say_written
from tactile_loc_cli.failures import NOT_AS_REQUIRED, Finding
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from tactile_loc.core.sensing.touch import Touch
    from tactile_loc.io.approach_files import Approach
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.identify import Identification
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.planning.next_touch import NextTouch
    from tactile_loc.store.store import StageStore

LIBRARY = "library.json"  # the manifest of a library of parts, which another command reads
NONE_OF_THESE = 1

Objects = Annotated[Path, declare("--objects FOLDER", "Folder of mesh files (stl, obj, step, glb, ...).")]
Touches = Annotated[
    str, declare("--touch FILE|LIST", "A touch file, or a list (.toml) of several touches of one object.")
]
Unknown = Annotated[
    float,
    declare("--unknown SHARE", "Share of touched objects that are none of these, before any touch: above 0, below 1."),
]
Given = Annotated[
    RunOptions,
    options.Takes(
        "units",
        "symmetry",
        *options.TOUCH_FILES,
        "press_depth",
        "sensor",
        "zero",
        *options.SETTINGS,
        symmetry="Rotational symmetry of every object, such as none or z6. Default: auto, detected for each object.",
    ),
]


@dataclass(frozen=True)
class IdentificationOutput(WantedApproaches):
    """What a command that identifies touches returns, shows and writes: its options `--out`, `--report` and others.

    With `around` or `candidates`, it also ranks the approaches that best separate the possible objects and their poses.
    Raises OutputError if nothing can be written to `out`.
    """

    out: Annotated[Path, declare("--out FOLDER", "Folder of identification.json.")] = Path("tactile-loc-identify")
    report: options.Report = False
    require: options.Require = None

    def __post_init__(self) -> None:
        require_writable(self.out)

    def conclude(self, found: Identification, touches: Sequence[Touch]) -> dict[str, Any]:
        """Show and write an identification of touches, and return the command's result.

        Raises Finding if the verdict is not the required one, or if "none of these" is most probable.
        """
        from tactile_loc.io.approach_files import write_approaches
        from tactile_loc.planning.identification_files import write_identification
        from tactile_loc.store.files import write_json
        from tactile_loc_cli.results import say_identification

        approaches, chosen = self._rate_approaches(found, touches)
        document = write_identification(found, touches, chosen)
        say_identification(found, len(touches), chosen)
        files = [write_json(self.out / "identification.json", document)]
        if self.around is not None and approaches:
            files.append(write_approaches(self.out / DRAWN, approaches, touches[0].T_base_sensor is not None))
        if self.report:
            from tactile_loc.reports.report import DEFAULT_NAME, write_page
            from tactile_loc.reports.tasks import make_identification_page

            files.append(write_page(make_identification_page(found, touches), self.out / DEFAULT_NAME))
        written = say_written(files)
        result = {**document, "written": written}
        if self.require is not None and result["verdict"] != self.require:
            raise Finding(NOT_AS_REQUIRED, result)
        if found.best is None:
            raise Finding(NONE_OF_THESE, result)
        return result

    def _rate_approaches(
        self, found: Identification, touches: Sequence[Touch]
    ) -> tuple[Sequence[Approach], NextTouch | None]:
        """Return the approaches and their ratings; none if none were asked for, or if no object is probable."""
        from tactile_loc.planning.next_touch import choose_next_touch
        from tactile_loc.tracking.pose_modes import PoseModes

        if (self.candidates is None and self.around is None) or (modes := PoseModes.of_objects(found)) is None:
            return [], None
        approaches = self.find(modes, touches[0].T_base_sensor)
        return approaches, choose_next_touch(modes, approaches)


def identify(
    objects: Objects,
    touch: Touches,
    given: Given,
    unknown: Unknown = 0.2,
    *,
    output: IdentificationOutput,
    store: options.Store = None,
) -> dict[str, Any]:
    """Find which of several objects was touched.

    The command also locates this object. Each object's model is built once and stored. The first line states the
    verdict and the probable objects. With --around or --candidates, the command also ranks the approaches that best
    separate the possible objects and their poses. The exit code is 1 if "none of these" is most probable. For many
    objects, use `library identify`, which is faster.
    """
    from tactile_loc.locate.identify import identify as identify_touches
    from tactile_loc.locate.probability.null_evidence import NullEvidence
    from tactile_loc.store.store import StageStore

    null = NullEvidence(unknown)
    settings = options.make_config(replace(given, touch=touch))
    models = _open_models(objects, settings, StageStore(store))
    touches = [one for _, one in options.read_touches(models[0], Path(touch))]
    return output.conclude(identify_touches(touches, models, null), touches)


def _open_models(folder: Path, config: RunConfig, store: StageStore) -> list[Localizer]:
    """Return a localizer for each mesh file in a folder. `config` has all their settings except the object.

    Raises ObjectError if there is no such folder, or no mesh in it, and ConfigError if the folder is a library.
    """
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.stored_object import list_mesh_files, load_stored_object

    if (folder / LIBRARY).exists():
        raise ConfigError(f"{folder} is a library of parts; run tactile-loc library identify {folder} --touch ...")
    if not os.path.isdir(folder):
        raise ObjectError(f"there is no folder {folder}; give one with a mesh file for each object")
    models = []
    for path in list_mesh_files(folder):
        chosen = config.object.model_copy(update={"path": str(path)})
        obj = load_stored_object(path, chosen.units, chosen.symmetry, store)
        models.append(Localizer(config.model_copy(update={"object": chosen}), obj, store, make_progress()))
    return models
