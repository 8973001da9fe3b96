"""The benchmark: suites of objects and touch sources, on which any method locates the objects."""
