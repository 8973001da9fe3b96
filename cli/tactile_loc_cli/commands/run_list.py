"""`tactile-loc run --touch touches.toml`: where is the object, given several touches at once?"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from tactile_loc_cli import flags

if TYPE_CHECKING:
    from tactile_loc.io.touch_lists import ListedTouch
    from tactile_loc.locate.localizer import Localizer, Observation


def is_list(path: Path) -> bool:
    """Whether this is a list of touches, by its name."""
    return path.suffix.lower() == ".toml"


def read_contacts(localizer: Localizer, path: Path) -> list[Observation]:
    """Read every touch of a list, each with the localizer of its sensor. Raises TactileLocError for bad input."""
    from tactile_loc.io.touch_lists import read_touch_list

    of_sensor = {None: localizer, localizer.config.sensor.name: localizer}
    contacts: list[Observation] = []
    for listed in read_touch_list(path):
        if listed.sensor not in of_sensor:
            of_sensor[listed.sensor] = _with_sensor(localizer, str(listed.sensor))
        contacts.append(_contact(of_sensor[listed.sensor], listed))
    return contacts


def _with_sensor(localizer: Localizer, sensor: str) -> Localizer:
    """The same localizer, but for its sensor, which is given by name, folder or file."""
    from tactile_loc.io.config import SlotConfig
    from tactile_loc.locate.localizer import Localizer

    chosen = SlotConfig.model_validate(flags.component("sensor", None, sensor, {}))
    config = localizer.config.model_copy(update={"sensor": chosen})
    return Localizer(config, localizer.object, localizer.store, localizer.progress)


def _contact(localizer: Localizer, listed: ListedTouch) -> Observation:
    touch = localizer.read_touch(listed.path, listed.unit, listed.press_depth_m)
    if listed.T_base_sensor is not None:
        touch = dataclasses.replace(touch, T_base_sensor=listed.T_base_sensor)
    return localizer, touch
