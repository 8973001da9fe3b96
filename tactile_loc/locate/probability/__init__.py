"""Probabilities of poses, and sets with a promised coverage."""
