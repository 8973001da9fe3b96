"""Sweeps: every combination of components on every object, evaluated by local processes or on a Dask cluster."""
