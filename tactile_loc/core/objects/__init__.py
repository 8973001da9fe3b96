"""Objects: meshes, their symmetry and their nearest surface."""
