"""Sets of poses: their metric, lattices, posteriors and priors."""
