"""The method: an object's model, scores, probabilities, hypotheses, and the result with its files."""
