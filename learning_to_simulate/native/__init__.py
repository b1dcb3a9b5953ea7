"""A trained model as C99 source and as a library called from Python; a soil field as an FMU.

`c/` holds the C that is the same for every model; `library` compiles and loads it. A model in a
subspace becomes values in `model_data`, a soil field in `soil_data`; `c_values` turns values into
C, `project` writes that as a CMake project, `fmu` as an FMU, `web_page` as a page. `binding` and
`soil_engine` call it by ctypes, `engines` makes steppers of it, `exporting` compares it with
TensorFlow.
"""

# A C project; of a soil field an FMU of FMI 2.0.
FORMATS = ('c', 'fmu')
