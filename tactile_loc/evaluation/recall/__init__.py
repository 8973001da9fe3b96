"""Evaluation of what `run` answers: examples with known poses, their errors and verdicts, tables, figures and files."""
