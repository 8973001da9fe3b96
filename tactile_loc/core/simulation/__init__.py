"""Simulated touches: contact poses, noise, and training data for encoders."""
