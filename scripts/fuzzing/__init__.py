"""The fuzzer of every reader: correct files, damage to them, readers, and findings."""
