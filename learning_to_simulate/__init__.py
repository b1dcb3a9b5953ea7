"""Graph-network simulator of soil modes driven by a rigid body.

A TensorFlow 2 system in the shape of DeepMind's `learning_to_simulate` (Sanchez-Gonzalez et al.,
ICML 2020). Letters used in every docstring: N soil particles, r modes, R rigid particles,
V = R + r nodes, E edges, T frames, H = 6 input frames, D = 3 axes, B graphs in a batch,
C context values, L latent width, M message-passing steps, S runs. Lengths in metres, forces in
newtons; velocities and accelerations are per frame.
"""
