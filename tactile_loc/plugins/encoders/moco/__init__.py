"""The learned encoder, trained in simulation by contrastive learning."""
