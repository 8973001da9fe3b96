"""Tasks built on the method: tracking, the next touch, identification, mounts, replay and live frames."""
