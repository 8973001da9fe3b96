"""Calibration of a sensor from presses of known objects."""
