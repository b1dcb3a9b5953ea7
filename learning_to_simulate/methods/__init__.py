"""Methods of simulation behind one registry; see `registry`."""
