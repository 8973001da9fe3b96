"""The joint refiner."""
