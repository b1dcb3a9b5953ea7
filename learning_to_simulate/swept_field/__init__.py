"""The swept field: soil and force as functions of what the tool has swept.

One small network, shared by all particles, takes what a particle has experienced (its place
relative to the tool, the deepest cut so far around it, how far the tool has gone since) to its
displacement from rest; a second one takes the profile about the tool's edge to force and torque.
Nothing is integrated over time and there are no modes: each frame follows from the path so far and
the bed it began on, so errors do not accumulate and any frame rate will do.

It is a coordinate network conditioned on the path, a relative of neural fields (Xie et al. 2022,
Computer Graphics Forum 41) and of DeepONet (Lu et al. 2021, Nature Machine Intelligence 3), whose
branch net sees the input function as these inputs see the path. That soil under a tool can be told
from the swept volume alone is an old idea of earthmoving simulators (e.g. Holz et al. 2009,
VRIPHYS).

The tool is a blade whose motion is given, or a driven wheel, whose height is predicted from what
it has driven; what differs between the two is in `learning_to_simulate.tool`.

network: both networks, their inputs from the tool's tables, all seeds at once.
episodes, training: from a dataset to weights.
field: the trained model, its soil and its folder.
engine: one frame a call, for a `live.stepper.Stepper`.
calibration: limits of training and bounds of the error.
evaluation, method, settings: rollouts and model folders, as the registry wants them.
"""
