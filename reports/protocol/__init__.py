"""The protocol that every method is judged by: per run first, in full space, over seeds."""
