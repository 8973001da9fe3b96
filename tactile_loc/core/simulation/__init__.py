"""Simulated touches: contact poses, noise and what a sensor would show."""
