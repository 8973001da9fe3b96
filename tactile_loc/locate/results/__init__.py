"""Results of locating: localisations, located frames, verdicts, and their files."""
