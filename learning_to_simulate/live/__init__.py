"""Live use: poses, starts, status, soil, whole paths."""
