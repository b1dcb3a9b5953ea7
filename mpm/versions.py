"""What a record was made with. A model says which data it was trained on; so these are counted up.

SOLVER: with every change of a kernel, a default or a body that changes results.
DATA: with every change of the list of runs, their splits, or what is drawn for a seed.
"""

SOLVER_VERSION = '5'
DATA_VERSION = '5'
