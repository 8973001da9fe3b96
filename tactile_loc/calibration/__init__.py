"""Sensor calibration: from presses of known shape to a network that estimates the indentation from images."""
