"""Rigid transforms, hand-eye calibration and trees of frames."""
