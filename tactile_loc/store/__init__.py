"""Results of stages on disk: keys, artifacts, workspaces, whole-or-nothing files."""
