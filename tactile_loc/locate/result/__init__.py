"""The result of a localisation, and its files."""
