"""The render refiner: compares rendered and observed images."""
