"""Simulated images of a gel: lamps, shading, boards."""
