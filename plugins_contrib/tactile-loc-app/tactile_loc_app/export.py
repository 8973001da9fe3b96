"""The files of a located object: the result, its report, and a Python script that computes the result again."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from tactile_loc import (
    DEMO_OBJECTS,
    GaussianPrior,
    Localization,
    Localizer,
    RunConfig,
    Touch,
    write_report,
    write_touch,
)
from tactile_loc.commands import write_atomically

from tactile_loc_app.errors import AppError

SCRIPT = "locate.py"
OBJECT, SENSOR = "object", "sensor"  # folders of the copies, whose names may be those of other files

_TEMPLATE = """# Locate {name!r} from {count}. Run: python {script}

from dataclasses import replace
from pathlib import Path

import numpy as np

from tactile_loc import GaussianPrior, Localizer, localize_together

HERE = Path(__file__).parent
TOUCHES = {touches}  # name, and standard deviations of the sensor's pose: m, rad

localizer = Localizer.create({object}, units={units!r}, symmetry={symmetry!r}, sensor={sensor})
touches = [
    replace(localizer.read_touch(HERE / name), T_base_sensor_std_m=std_m, T_base_sensor_std_rad=std_rad)
    for name, std_m, std_rad in TOUCHES
]
{prior}
result = localize_together([(localizer, touch) for touch in touches], prior)
print(result.summary())
result.save(HERE / "again")
"""
_PRIOR = """T_base_object = np.array({T})
expected = GaussianPrior(T_base_object, {std_m!r}, {std_rad!r}, localizer.object.symmetry)
prior = expected.view_from(touches[0].T_base_sensor)"""


def write_export(
    folder: Path, localizer: Localizer, found: Localization, prior: GaussianPrior | None = None
) -> list[Path]:
    """Write result.json, result.npz, report.html, the object, the sensor, the touches and locate.py; return the paths.

    The script locates the object again from the files in the folder. `prior` is the prior of the result, in the base
    frame. Raises AppError if a file cannot be written.
    """
    found = dataclasses.replace(found, config=_name_copies(localizer.config))
    written = found.save(folder)
    written.append(write_report(written[0]))
    names = [f"touch-{number}.npz" for number in range(1, len(found.touches) + 1)]
    written += [write_touch(folder / name, touch) for name, touch in zip(names, found.touches, strict=True)]
    script = _write_script(folder, localizer, found, names, prior)
    return [*written, write_atomically(folder / SCRIPT, lambda temporary: temporary.write_text(script, "utf-8"))]


def _name_copies(config: RunConfig) -> RunConfig:
    """Return the settings with the paths of the copies of the object's and the sensor's files."""
    chosen, sensor = config.object, config.sensor
    options = {key: _name_copy(SENSOR, value) if key == "path" else value for key, value in sensor.options.items()}
    path = chosen.path if _is_demo(chosen.path) else _name_copy(OBJECT, chosen.path)
    return config.model_copy(
        update={
            "object": chosen.model_copy(update={"path": path}),
            "sensor": sensor.model_copy(update={"options": options}),
        }
    )


def _is_demo(path: str) -> bool:
    return path in DEMO_OBJECTS and not Path(path).is_file()


def _name_copy(part: str, path: str) -> str:
    return f"{part}/{Path(path).resolve().name}"


def _write_script(
    folder: Path, localizer: Localizer, found: Localization, names: list[str], prior: GaussianPrior | None
) -> str:
    """Return the text of the script, and copy the object and the sensor that it reads."""
    chosen = localizer.config.object
    return _TEMPLATE.format(
        name=localizer.object.name,
        count="1 touch" if len(names) == 1 else f"{len(names)} touches",
        script=SCRIPT,
        touches=_list_touches(names, found.touches),
        object=_copy_object(folder, chosen.path),
        units=chosen.units,
        symmetry=chosen.symmetry,
        sensor=_copy_sensor(folder, localizer),
        prior=_write_prior(prior),
    )


def _list_touches(names: list[str], touches: tuple[Touch, ...]) -> str:
    rows = (
        f"    ({name!r}, {touch.T_base_sensor_std_m!r}, {touch.T_base_sensor_std_rad!r}),\n"
        for name, touch in zip(names, touches, strict=True)
    )
    return f"[\n{''.join(rows)}]"


def _copy_object(folder: Path, path: str) -> str:
    """Return the object as Python: a demo object's name, or the path of a copy of its file."""
    return repr(path) if _is_demo(path) else _copy(folder, OBJECT, path)


def _copy_sensor(folder: Path, localizer: Localizer) -> str:
    """Return the sensor as Python: its name, or its options with the path of a copy of its file or folder."""
    sensor = localizer.config.sensor
    if not sensor.options:
        return repr(sensor.name)
    options: dict[str, Any] = {"name": sensor.name, **sensor.options}
    values = (
        f"{key!r}: str({_copy(folder, SENSOR, value)})" if key == "path" else f"{key!r}: {value!r}"
        for key, value in options.items()
    )
    return f"{{{', '.join(values)}}}"


def _copy(folder: Path, part: str, path: str) -> str:
    """Copy a file or a folder into the folder `part`, and return the copy's path as Python. Raises AppError."""
    source, name = Path(path).resolve(), _name_copy(part, path)
    try:
        (folder / part).mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, folder / name, dirs_exist_ok=True)
        else:
            shutil.copyfile(source, folder / name)
    except (OSError, shutil.Error) as error:
        raise AppError(f"{source.name} cannot be copied to {folder}; choose another folder") from error
    return f"HERE / {name!r}"


def _write_prior(prior: GaussianPrior | None) -> str:
    if prior is None:
        return "prior = None"
    return _PRIOR.format(
        T=np.asarray(prior.T).tolist(), std_m=float(prior.translation_std_m), std_rad=float(prior.rotation_std_rad)
    )
