"""What `tactile-loc doctor` looks at: this machine, what is installed on it, and whether it works."""
