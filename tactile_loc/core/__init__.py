"""Data types, interfaces and numerical kernels. Imports no plugin and nothing heavy."""
