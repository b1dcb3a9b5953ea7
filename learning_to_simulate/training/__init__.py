"""Training: windows, noise, losses, steps; the run on disk, one loop for every method."""
