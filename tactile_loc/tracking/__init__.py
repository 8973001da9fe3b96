"""Poses over time: tracker, replay, live."""
