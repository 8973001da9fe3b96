"""What all code runs on: errors, progress, compiled code and its cache."""
