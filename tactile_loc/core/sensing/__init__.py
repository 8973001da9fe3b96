"""Sensing: sensor geometry, contact, touches and places."""
