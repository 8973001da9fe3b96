"""Contract checks of touch sources and methods."""
