"""A trained model as C99 source, as a library called from Python, and as an FMU.

`native/` holds the C that is the same for every model; `model_data` folds a model into constants
for it; `project` writes both as a CMake project, `fmu` as an FMU; `c_stepper` runs them in Python.
"""

# A C project, an FMU of FMI 2.0.
FORMATS = ('c', 'fmu')
