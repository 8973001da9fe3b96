"""Meshes from files of several formats."""
