"""The soil field: a tool anywhere on a terrain, from what it has swept.

tools, terrain, place: a tool, what it works on, and where: what lies under it and beside it.
sweep, passage: what it has swept.
inputs, network: three networks that tell load, surface and particles from that.
runs, samples, training: what it learns from, and how.
field: a trained model and its folder.
stepper, loaded, tracer: a tool frame by frame, under a load, with particles about it.
"""
