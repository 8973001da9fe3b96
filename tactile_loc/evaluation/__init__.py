"""Evaluations: simulated touches, metrics, protocols and tables."""
