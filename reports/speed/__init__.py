"""Times: rollouts, live steps, training; what a rollout leaves out."""
