"""Mutants of the numerical core: which there are, and which the tests notice."""
