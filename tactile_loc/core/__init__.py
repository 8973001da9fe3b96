"""The nouns and the interfaces. Imports no plugin and nothing heavy."""
