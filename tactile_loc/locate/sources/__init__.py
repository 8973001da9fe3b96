"""Sources of candidate poses: a listed grid, or a search of the whole object."""
