"""What the rollout of a model leaves out for its scene, and what each item is worth."""
