"""The cameras of this computer by names that stay when they are plugged in again, and their fixed settings."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from tactile_loc.core.runtime.errors import SourceError

log = logging.getLogger(__name__)

BY_NAME = Path("/dev/v4l/by-id")  # links such as usb-Facebook_DIGIT_D20123-video-index0
FIRST = "-video-index0"  # ends the name of a camera's images; further streams hold metadata

# For each setting: its name, OpenCV's property, that of its mode, and the modes "fixed" and "automatic" (Video4Linux).
SETTINGS = {
    "exposure": ("exposure", "CAP_PROP_EXPOSURE", "CAP_PROP_AUTO_EXPOSURE", 1, 3),
    "white_balance_k": ("white balance", "CAP_PROP_WB_TEMPERATURE", "CAP_PROP_AUTO_WB", 0, 1),
}
UNKNOWN = (0, -1)  # what OpenCV states of a property that a camera does not have


@dataclass(frozen=True)
class CameraSettings:
    """A camera's fixed settings: the `exposure`, in units of 0.1 ms on Linux, and the white balance, kelvin.

    None means that a setting is automatic, or unknown.
    """

    exposure: float | None = None
    white_balance_k: float | None = None

    def fix(self, opened: Any, about: str) -> Self:
        """Fix the given settings of a VideoCapture of OpenCV called `about`, and return all that are fixed.

        Logs a warning about automatic settings. Raises SourceError if the camera does not take a value.
        """
        import cv2

        found, automatic = {}, []
        for key, (name, value, mode, fixed, auto) in SETTINGS.items():
            value_id, mode_id, wanted = getattr(cv2, value), getattr(cv2, mode), getattr(self, key)
            if wanted is not None:
                opened.set(mode_id, fixed)
                opened.set(value_id, wanted)
                if (taken := opened.get(value_id)) != wanted:
                    raise SourceError(
                        f"{about} does not take the {name} {wanted:g}, and has {taken:g} now; give a value that "
                        "the camera's driver allows (`v4l2-ctl -L` lists them), or leave it out"
                    )
            is_automatic = opened.get(mode_id) == auto
            automatic += [name] if is_automatic else []
            found[key] = None if is_automatic or opened.get(value_id) in UNKNOWN else opened.get(value_id)
        if automatic:
            log.warning(
                "%s sets its %s automatically, so the same touch looks different at times; fix the exposure and the "
                "white balance",
                *(about, " and ".join(automatic)),
            )
        return type(self)(**found)


NOT_FIXED = CameraSettings()


def list_cameras() -> list[str]:
    """Return the names of the connected cameras, which contain maker, model and serial number, in order."""
    if not BY_NAME.is_dir():
        return []
    return sorted(path.name.removesuffix(FIRST) for path in BY_NAME.iterdir() if path.name.endswith(FIRST))


def find_device(camera: str) -> str:
    """Return the number or the path of a camera, given by these, or by a part of its name, such as the serial number.

    Raises SourceError unless exactly one camera has this part in its name.
    """
    if camera.isdigit() or set(camera) & set("/:!"):  # also an address or a pipeline of a stream
        return camera
    connected = list_cameras()
    found = [name for name in connected if camera.lower() in name.lower()]
    if len(found) == 1:
        return str(BY_NAME / f"{found[0]}{FIRST}")
    said = (
        f"{len(found)} connected cameras have {camera!r} in their names" if found else f"there is no camera {camera!r}"
    )
    known = f"connected: {', '.join(connected)}" if connected else "this computer lists no cameras by name"
    raise SourceError(f"{said} ({known}); give a camera's number, its device, or its serial number")
