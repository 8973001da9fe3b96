"""What a tactile sensor sees: its geometry, contact, touches and places."""
