"""`tactile-loc evaluate` and `tactile-loc paper`."""
