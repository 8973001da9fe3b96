"""Metrics, protocols and figures."""
