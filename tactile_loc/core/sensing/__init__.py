"""Sensing: sensor geometry, contact, touches, and how poses explain them."""
