"""The built-in sources of touches."""
