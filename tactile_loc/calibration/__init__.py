"""Calibrating a sensor: from presses of known shape to a network that turns images of the gel into its indentation."""
