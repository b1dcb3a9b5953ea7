"""A trained model as C99 source, as a library called from Python, and as an FMU.

`c/` holds the C that is the same for every model; `library` compiles and loads it. `model_data` and
`field_data` turn a model into values, `c_values` turns values into C. `project` writes both as a
CMake project, `fmu` as an FMU, `web_page` as a page. `binding` calls them by ctypes, `engines`
makes steppers of them, `agreement` compares them with TensorFlow. Of a soil field `soil_data` makes
values, and `soil_engine` calls them.
"""

# A C project, an FMU of FMI 2.0.
FORMATS = ('c', 'fmu')
