"""Ground truth: a 3-D material point solver of granular soil moved by a blade or a wheel."""

# What a record was made with. A model says which data it was trained on; so these are counted up.
SOLVER_VERSION = '5'  # with every change of a kernel, a default or a body that changes results
DATA_VERSION = '5'  # with every change of the list of runs, their splits, or what a seed draws
