"""Data types and numerical kernels. This package imports no plugin and no large library."""
