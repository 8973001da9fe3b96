"""Base classes that components share: they fill most of an interface."""
