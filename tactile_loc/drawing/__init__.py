"""Pictures of touches, poses and results."""
