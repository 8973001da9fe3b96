"""Simulated tactile images: the elastomer's surface, the lights that shade it, and boards to press on it."""
