"""The learned encoder, by contrast in simulation."""
