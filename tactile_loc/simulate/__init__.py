"""Simulated touches, their noise, and touches for training."""
