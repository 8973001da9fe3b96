"""Simulated touches, and touches for training."""
