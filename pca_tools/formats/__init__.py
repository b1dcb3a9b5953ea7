"""Formats of other projects, both ways, through one thing: `full_space.FullSpaceData`.

One module per format: `read(folder, options)` gives the data, `write(folder, data)` writes them.
"""
