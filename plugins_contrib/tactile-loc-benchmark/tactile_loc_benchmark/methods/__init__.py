"""The built-in methods: tactile-loc itself, and its competitors."""
