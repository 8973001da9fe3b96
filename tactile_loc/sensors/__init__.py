"""From image to contact shape: calibration, reading, optics."""
