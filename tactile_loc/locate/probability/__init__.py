"""Probabilities of poses: scores (temperature), what a result shows (evidence, probes), its outcome, and pose sets."""
