"""The learned encoder: trained by contrast, in simulation."""
