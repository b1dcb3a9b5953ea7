"""`TrainConfig`: everything that decides what a trained simulator is.

A frozen value; the whole of it is stored as JSON beside the weights, so that no flag can change
their meaning.
"""

import dataclasses

from learning_to_simulate.methods import registry

INPUT_SEQUENCE_LENGTH = 6  # H, as in Sanchez-Gonzalez et al. 2020


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Everything that decides what a model is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `methods.registry`.
      adjacency: 'fully_connected'; 'algorithm2' (its mode block from `edges.json` of the dataset
        where there is one, else ranked by correlation); 'correlation' (always ranked); the edge
        file that was loaded; 'none' for a model without a graph, and for full_space, whose
        radius graph is made in every step.
      soil_particles: about how many soil particles the full-space model keeps; else 0.
      mode_edges: mode -> mode edges that are kept when they are ranked by correlation.
      gate_weight: above 0 the mode -> mode edges are learned together with the simulator, one
        hard-concrete gate each, and this is the price of all of them being open (`edge_gates`).
      gate_steps: after so many steps the gates close for good and the edge list is fixed.
      gate_keep: how many edges are then kept, the most probable ones; 0 keeps those more likely
        open than not.
      rigid_particles: how many rigid particles are nodes, the lowest ones of the first frame; 0
        keeps all. Only
        where the motion is prescribed: a blade cuts with its lower edge, and the rest follows from
          it.
      rigid_stride: every how many-th rigid particle, in record order, is a node, whatever moves the
        body; 1 keeps all. The others are placed rigidly. Where the body is not prescribed, the mean
        height of the kept ones must be that of all.
      surface_height: m; a rigid particle above it has no edges in that frame (`tool_depth`); 0 for
        edges that last.
      modes: the first so many modes of the dataset are nodes, the others say 0 in every prediction
        and count in every error; 0 keeps all.
      conditioned: per-mode and per-edge statistics, position inputs, node embeddings and mean
        aggregation; otherwise the published inputs with dataset-wide statistics and sum
        aggregation.
      velocity_inputs: how many of the H - 1 last velocities are inputs.
      rate_scaled: velocities in and displacements out are counted per displacement of the body in
        the coming frame (soil at these speeds is nearly rate-independent); needs a known motion and
        order 1.
      predict_driven_body: predict every particle of a body whose rotation and travel are given, the
        published way, instead of its height alone.
      mode_order, rigid_order: 2 predicts acceleration, 1 predicts the displacement of the frame.
      noise_std: random-walk noise of the last input step; m/frame, or a fraction of each node's own
        velocity scale if `noise_relative`.
      latent_size, hidden_layers, message_passing_steps: L, layers per MLP, M (blocks of a mixer).
      batch_size, num_steps: single-step stage.
      unroll_length, unroll_steps, unroll_batch_size: N-step stage with gradients through the
        rollout.
      unroll_noise: noise of the unrolled stage, as a share of `noise_std`.
      unroll_learning_rate: rate that the unrolled stage starts from.
      learning_rate, learning_rate_floor, decay_steps: lr decays by 0.1 per `decay_steps` to the
        floor.
      weight_average: decay of the moving average of the weights that is evaluated and saved; 0 for
        none.
      zero_decoder: the decoder starts from zero, so that training starts from the mean prediction:
        constant velocity in order 2.
      seed: of weights, batches and noise.
    """

    preset: str
    model: str = 'gns'
    adjacency: str = 'algorithm2'
    soil_particles: int = 0
    mode_edges: int = 28
    gate_weight: float = 0.0
    gate_steps: int = 1000
    gate_keep: int = 0
    rigid_particles: int = 10
    rigid_stride: int = 1
    surface_height: float = 0.0
    modes: int = 0
    conditioned: bool = True
    velocity_inputs: int = 1
    rate_scaled: bool = True
    predict_driven_body: bool = False
    mode_order: int = 1
    rigid_order: int = 1
    noise_std: float = 0.5
    noise_relative: bool = True
    latent_size: int = 64
    hidden_layers: int = 2
    message_passing_steps: int = 1
    batch_size: int = 16
    num_steps: int = 3000
    unroll_length: int = 16
    unroll_steps: int = 2000
    unroll_batch_size: int = 8
    unroll_noise: float = 0.0
    unroll_learning_rate: float = 3e-4
    learning_rate: float = 1e-3
    learning_rate_floor: float = 1e-5
    decay_steps: float = 3000.0
    weight_average: float = 0.998
    zero_decoder: bool = False
    seed: int = 0

    def __post_init__(self):
        method = registry.get(self.model)
        if (self.adjacency == 'none') == method.has_graph:
            raise ValueError(
                f'adjacency is {self.adjacency!r} with model {self.model!r}: gns needs one, the '
                f'others take none'
            )
        if self.surface_height and not method.has_graph:
            raise ValueError(
                f'surface_height is {self.surface_height} with model {self.model!r}: only gns has '
                f'edges between modes and body'
            )
        if (self.soil_particles > 0) != method.on_particles:
            raise ValueError(
                f'soil_particles is {self.soil_particles} with model {self.model!r}: full_space '
                f'needs some, the others take 0'
            )
        if method.on_particles and self.unroll_steps:
            raise ValueError(
                f'unroll_steps is {self.unroll_steps}, but {self.model} is trained in single '
                f'steps: 0'
            )
        if method.on_particles and (self.modes or self.rigid_stride > 1):
            raise ValueError(
                f'{self.model} has no modes and takes the whole body: modes 0, rigid_stride 1'
            )
        for name, low in (
            ('mode_edges', 0),
            ('gate_weight', 0.0),
            ('gate_steps', 1),
            ('gate_keep', 0),
            ('latent_size', 1),
            ('hidden_layers', 1),
            ('message_passing_steps', 1),
            ('batch_size', 1),
            ('num_steps', 0),
            ('unroll_length', 2),
            ('unroll_steps', 0),
            ('unroll_batch_size', 1),
            ('noise_std', 0.0),
            ('rigid_particles', 0),
            ('rigid_stride', 1),
            ('modes', 0),
            ('velocity_inputs', 1),
        ):
            if not getattr(self, name) >= low:
                raise ValueError(f'{name} is {getattr(self, name)!r}, must be at least {low}')
        for name in ('mode_order', 'rigid_order'):
            if getattr(self, name) not in (1, 2):
                raise ValueError(
                    f'{name} is {getattr(self, name)!r}, must be 1 (displacement) or 2 '
                    f'(acceleration)'
                )
        if self.velocity_inputs >= INPUT_SEQUENCE_LENGTH:
            raise ValueError(
                f'velocity_inputs is {self.velocity_inputs}, a history has '
                f'{INPUT_SEQUENCE_LENGTH - 1} velocities'
            )
        if self.gate_weight > 0 and self.gate_steps >= self.num_steps:
            raise ValueError(
                f'gate_steps is {self.gate_steps}, but the gates must close before the end of the '
                f'single-step stage of {self.num_steps} steps'
            )
        if self.gate_weight > 0 and self.adjacency != 'algorithm2':
            raise ValueError(
                f'gate_weight {self.gate_weight} learns the edges, but adjacency '
                f'{self.adjacency!r} gives them: leave one of them out'
            )
        if self.rate_scaled and (self.mode_order, self.rigid_order) != (1, 1):
            raise ValueError(
                'rate_scaled needs mode_order and rigid_order 1: an acceleration does not scale '
                'with the rate'
            )
        if not 0 <= self.weight_average < 1:
            raise ValueError(f'weight_average is {self.weight_average}, must lie in [0, 1)')

    @property
    def has_lasting_graph(self) -> bool:
        """Whether the model is a graph network with the same edges in every frame: only then
        rollouts are specialised for them."""
        return registry.get(self.model).has_graph and not self.surface_height

    @property
    def nodes(self) -> dict[str, int]:
        """Which nodes of the records are used, as arguments of `reading_utils.read_groups`."""
        return {name: getattr(self, name) for name in ('rigid_particles', 'rigid_stride', 'modes')}
