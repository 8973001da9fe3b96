"""The localisation method: object models, scores, probabilities, hypotheses, and results with their files."""
