"""Edges that follow the depth of the tool: a rigid particle above the ground has none.

The dynamic graph that Usmani & Skonieczny 2023 (4.1) propose. Compiled graphs have fixed shapes, so
the messages of edges that are absent in a frame are computed and weighted by 0: it changes what is
predicted, and saves nothing.
"""

import numpy as np
import tensorflow as tf


def edge_gates(simulator, state, layout):
    """Weights of the messages in the frame after `state`.

    Args:
      simulator: `LearnedSimulator`; its config's `surface_height` says where the ground is.
      state: `SimulatorState` of B graphs.
      layout: of the graphs.

    Returns:
      float32 [B or 1, E] in [0, 1]: those of the layout, and 0 at the edges of rigid particles that
      are higher than the ground; None where all edges last.
    """
    surface = simulator.config.surface_height
    if not surface:
        return layout.edge_gates
    n, up = layout.n_rigid, simulator.scene.up_axis
    height = state.offset[:, :n, up] + tf.cast(layout.origin[:n, up], state.offset.dtype)
    in_soil = tf.cast(height <= np.float32(surface), tf.float32)
    present = tf.pad(in_soil, [[0, 0], [0, layout.n_node - n]], constant_values=1.0)
    ends = (tf.gather(present, index, axis=1) for index in (layout.senders, layout.receivers))
    gates = tf.multiply(*ends)
    return gates if layout.edge_gates is None else gates * layout.edge_gates
