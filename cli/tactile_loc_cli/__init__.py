"""The command line of tactile-loc."""
