"""What locating found: distributions, located frames, verdicts, and their files."""
