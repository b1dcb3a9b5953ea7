"""What all packages share: files and folders that appear whole or not at all, folders with one
writer, tables.

The standard library is all that this package needs, so that the solver (`mpm`) and everything else
share one implementation and neither needs the other.
"""
