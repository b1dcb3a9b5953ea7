"""Many independent jobs on one machine or on many: see `cluster.workers`.

Knows nothing of soil: whoever has a function and a list of inputs may use it.
"""
