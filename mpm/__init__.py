"""Ground truth: a 3-D material point solver of granular soil moved by a blade or a wheel."""
