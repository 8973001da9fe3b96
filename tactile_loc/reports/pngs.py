"""Pictures that lie beside a result, as data URIs of a sensible size."""

from __future__ import annotations

import logging
from pathlib import Path

from tactile_loc.reports.shape_pictures import data_uri

log = logging.getLogger(__name__)

WIDEST_PX = 1400
COLOURS = 255


def picture(path: Path) -> str | None:
    """Return a PNG as a data URI, at most WIDEST_PX wide and with at most COLOURS colours; None if there is none.

    A picture that cannot be read is left out with a warning.
    """
    if not path.is_file():
        return None
    from PIL import Image

    try:
        with Image.open(path) as image:
            small = image.convert("RGB")
    except OSError:
        log.warning(f"{path} cannot be read as a picture and is left out of the report")
        return None
    if small.width > WIDEST_PX:
        small = small.resize((WIDEST_PX, round(small.height * WIDEST_PX / small.width)), Image.Resampling.LANCZOS)
    return data_uri(small.quantize(COLOURS))
