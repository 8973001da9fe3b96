"""Pictures and scenes of results."""
