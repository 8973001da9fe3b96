"""Evaluations: simulated touches, metrics, protocols, tables and figures."""
