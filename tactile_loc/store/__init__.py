"""Results of stages on disk: keys, artifacts, workspaces, and files that are written atomically."""
