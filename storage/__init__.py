"""Files and folders that appear whole or not at all, and folders with one writer.

The standard library is all that this package needs, so that the solver (`mpm`) and everything else
share one implementation and neither needs the other.
"""
