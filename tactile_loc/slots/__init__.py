"""The interfaces of the stages, their registry, and the rules of compatibility."""
