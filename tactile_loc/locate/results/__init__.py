"""Results of the localisation: localisations, located frames, verdicts, and their files."""
