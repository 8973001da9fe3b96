"""The joint registration of poses to touches."""
