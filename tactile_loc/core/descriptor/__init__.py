"""A descriptor of contacts that was trained once for all objects: unit vectors of places and of touches."""
