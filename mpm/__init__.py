"""Ground truth: a 3-D material point solver of granular soil moved by a blade or a wheel."""

# What a record was made with. Models name the data that they learned from, so raise these
SOLVER_VERSION = '5'  # on a change of a kernel, a default or a body that changes results
DATA_VERSION = '5'  # on a change of the list of runs, their splits, or what a seed draws
