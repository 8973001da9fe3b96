"""The refiner that renders and compares."""
