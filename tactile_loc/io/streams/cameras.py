"""The cameras of this computer by names that stay the same when they are plugged in again. Linux names them so."""

from pathlib import Path

from tactile_loc.core.runtime.errors import SourceError

BY_NAME = Path("/dev/v4l/by-id")  # links such as usb-Facebook_DIGIT_D20123-video-index0
FIRST = "-video-index0"  # ends the name of a camera's images; further streams hold metadata


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
