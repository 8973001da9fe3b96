"""The settings of a localizer for one face and a small image, with which tests track an object fast."""

from typing import Any

SETTINGS: dict[str, Any] = {
    "shape_px": 60, "sensor": {"name": "gelslim", "image_size_px": [100, 100]},
    "grid": {"name": "face", "min_contact_percent": 2.0, "spacing_mm": 4.0}, "temperature": 0.005,
}  # fmt: skip
