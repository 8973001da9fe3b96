"""Simulated tactile images: the gel's surface, the lights that shade it, and boards to press on it."""
