"""A trained model as C99 source, as a library called from Python, and as an FMU.

`native/` holds the C that is the same for every model; `model_data` folds a model into the constants
that it reads; `project` writes both as a CMake project, `c_stepper` runs them from Python.
"""
