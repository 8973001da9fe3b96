"""The seven plugin interfaces, the scene that they share, and their registry."""
