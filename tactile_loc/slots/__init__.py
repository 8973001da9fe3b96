"""The interfaces of the stages, their registry, and hashes of their code."""
