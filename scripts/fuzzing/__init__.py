"""The fuzzer of every reader: correct files, the damage to these files, the readers, and the findings."""
