"""The next touch, and the sensor's mount."""
