"""`tactile-loc evaluate`."""
