"""Methods beside the graph network: each predicts the same runs from the same inputs."""
