"""The soil field: a tool anywhere on a terrain, from what it has swept.

From a pose to a frame, in this order (in C one goes from `stepper` to `native.soil_engine`):

stepper: a tool on a terrain, for users; engine: what is refused, when a passage begins anew.
passage: a tool on its way, what it may write into the terrain; sweep: what it has swept.
field: a trained model and its folder, what it was taught; network: load, surface, particles.

These use tools, terrain and place (where a tool works, the strips under it and beside it), and
inputs (tables of what the networks see). tracer, loaded, rollout: particles, a tool under a load, a
whole way. runs, samples, training, evaluation: what a field learns from, how, and its errors. digs,
fit_soil: a soil from a few recorded digs.
"""
