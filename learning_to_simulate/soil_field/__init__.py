"""The soil field: a tool anywhere on a terrain, from what it has swept.

place, terrain: where a tool works, and on what.
tools, strips, sweep, passage: a tool, what lies under and beside it, what it has swept.
inputs, network: three networks that tell load, surface and particles from that.
runs: what it learns from.
"""
