"""The fuzzer of every reader: what is damaged, how, who reads it, and what counts as a finding."""
