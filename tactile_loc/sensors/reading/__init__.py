"""The gel's surface, read from an image by a calibration."""
