"""The seven interfaces of plugins, the scene that they share, and their registry."""
