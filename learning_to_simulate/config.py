"""`TrainConfig`: everything that decides what a trained simulator is, in parts.

Each part is a frozen value that checks itself; the whole is all of them at once. So names are flat
on command lines and in `config.json`, and what needs one part only, takes that part. The whole is
stored beside the weights, so that no flag can change their meaning.
"""

import dataclasses

from learning_to_simulate import registry

INPUT_SEQUENCE_LENGTH = 6  # H, as in Sanchez-Gonzalez et al. 2020
LARGEST = 2**62
# No body of the project has more than 20 particles; a damaged number must not ask for the memory
# of a graph of millions.
MAX_RIGID, MAX_MODES = 1000, 10_000


def number(default, low=-LARGEST, high=LARGEST):
    """A setting with its least and largest value; the largest ones of parts are beyond any network
    of the project."""
    return dataclasses.field(default=default, metadata={'range': (low, high)})


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings that check their types, their ranges and the rules of their parts.

    A part has a method `rules`, which raises where its fields do not fit each other.
    """

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value, kind = getattr(self, field.name), field.type
            # JSON and command lines may write a whole number for a float.
            kinds = (int, float) if kind is float else kind
            is_truth = isinstance(value, bool)
            if not isinstance(value, kinds) or is_truth != (kind is bool):
                raise ValueError(f'{field.name} is {value!r}, must be of type {kind.__name__}')
            low, high = field.metadata.get('range', (-LARGEST, LARGEST))
            if kind in (int, float) and not low <= value <= high:  # false for NaN as well
                raise ValueError(
                    f'{field.name} is {value!r}, must be at least {low:g} and at most {high:g}'
                )
        for part in type(self).__mro__:
            if 'rules' in vars(part):
                part.rules(self)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Nodes(Settings):
    """What of the records is a node.

    Attributes:
      rigid_particles: how many rigid particles are nodes, the lowest ones of the first frame; 0
        keeps all. Only where the motion is prescribed: a blade cuts with its lower edge, and the
        rest follows from it.
      rigid_stride: every how many-th rigid particle, in record order, is a node, whatever moves the
        body; 1 keeps all. The others are placed rigidly. Where the body is not prescribed, the mean
        height of the kept ones must be that of all.
      modes: the first so many modes of the dataset are nodes, the others say 0 in every prediction
        and count in every error; 0 keeps all.
      soil_particles: about how many soil particles the full-space model keeps; else 0.
    """

    rigid_particles: int = number(10, 0, MAX_RIGID)
    rigid_stride: int = number(1, 1, MAX_RIGID)
    modes: int = number(0, 0, MAX_MODES)
    soil_particles: int = 0

    @property
    def nodes(self) -> dict[str, int]:
        """Which nodes of the records are used, as arguments of `reading_utils.read_groups`."""
        return {name: getattr(self, name) for name in ('rigid_particles', 'rigid_stride', 'modes')}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Edges(Settings):
    """Which node acts on which.

    Attributes:
      adjacency: 'fully_connected'; 'algorithm2' (its mode block from `edges.json` of the dataset
        where there is one, else ranked by correlation); 'correlation' (always ranked);
        'random' (by lot, from the seed); the edge file that was loaded; 'none' for a model without
        a graph, and for full_space, whose radius graph is made in every step.
      mode_edges: mode -> mode edges that are kept when they are ranked by correlation or drawn.
      surface_height: m; a rigid particle above it has no edges in that frame (`tool_depth`); 0 for
        edges that last.
      gate_weight: above 0 the mode -> mode edges are learned together with the simulator, one
        hard-concrete gate each, and this is the price of all of them being open (`edge_gates`).
      gate_steps: after so many steps the gates close for good and the edge list is fixed.
      gate_keep: how many edges are then kept, the most probable ones; 0 keeps those more likely
        open than not.
    """

    adjacency: str = 'algorithm2'
    mode_edges: int = number(28, 0, MAX_MODES**2)
    surface_height: float = 0.0
    gate_weight: float = number(0.0, 0)
    gate_steps: int = number(1000, 1)
    gate_keep: int = number(0, 0, MAX_MODES**2)

    def rules(self):
        """Raises where edges are both learned and given."""
        if self.gate_weight > 0 and self.adjacency != 'algorithm2':
            raise ValueError(
                f'gate_weight {self.gate_weight} learns the edges, but adjacency '
                f'{self.adjacency!r} gives them: leave one of them out'
            )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Inputs(Settings):
    """What a node sees, and what of it is predicted.

    Attributes:
      conditioned: per-mode and per-edge statistics, position inputs, node embeddings and mean
        aggregation; otherwise the published inputs with dataset-wide statistics and sum
        aggregation. Code asks for one of its meanings, which are properties.
      velocity_inputs: how many of the H - 1 last velocities are inputs.
      rate_scaled: velocities in and displacements out are counted per displacement of the body in
        the coming frame (soil at these speeds is nearly rate-independent); needs a known motion and
        order 1.
      predict_driven_body: predict every particle of a body whose rotation and travel are given, the
        published way, instead of its height alone.
      mode_order, rigid_order: 2 predicts acceleration, 1 predicts the displacement of the frame; 0
        (modes only, with `path_inputs`) predicts where they are, counted from the last given frame:
        then no error is carried from frame to frame but by the inputs.
      path_inputs: what the tool has done since the start of the run is an input (`path_memory`);
        needs a body whose whole motion is given.
      state_inputs: whether the state of the modes is an input; without it (with `path_inputs`, no
        graph) a frame depends on the path alone.
      predict_torque: whether the torque on the body is predicted beside the force; needs records of
        it, of one body.
    """

    conditioned: bool = True
    velocity_inputs: int = number(1, 1, INPUT_SEQUENCE_LENGTH - 1)
    rate_scaled: bool = True
    predict_driven_body: bool = False
    mode_order: int = number(1, 0, 2)
    rigid_order: int = number(1, 1, 2)
    path_inputs: bool = False
    state_inputs: bool = True
    predict_torque: bool = False

    def rules(self):
        """Raises where an acceleration would be scaled with the rate, or a path is missing."""
        if not self.path_inputs and (self.mode_order == 0 or not self.state_inputs):
            raise ValueError(
                f'mode_order {self.mode_order} and state_inputs {self.state_inputs} need '
                f'path_inputs: a place and soil without a state follow from the path alone'
            )
        if self.path_inputs and not self.conditioned:
            raise ValueError('path_inputs needs conditioned: the published inputs have no path')
        if self.rate_scaled and (self.mode_order, self.rigid_order) != (1, 1):
            raise ValueError(
                'rate_scaled needs mode_order and rigid_order 1: an acceleration does not scale '
                'with the rate'
            )

    # What `conditioned` stands for, by meaning: code asks for these.

    @property
    def statistics_by_class(self) -> bool:
        """Whether inputs and targets are scaled by each node class's own statistics, and edges by
        those of each pair; else by the dataset's, and edges by the connectivity radius."""
        return self.conditioned

    @property
    def position_inputs(self) -> bool:
        """Whether positions, accelerations and the height of a driven body are inputs."""
        return self.conditioned

    @property
    def coming_motion_input(self) -> bool:
        """Whether the given motion of the coming frame is an input."""
        return self.conditioned

    @property
    def embedding_by_class(self) -> bool:
        """Whether every mode has an embedding of its own; else every particle type."""
        return self.conditioned

    @property
    def contact_gate(self) -> bool:
        """Whether a body shows no force where it is clear of the soil, if training runs are."""
        return self.conditioned

    @property
    def mean_aggregation(self) -> bool:
        """Whether a node takes the mean of its messages; else their sum, as published."""
        return self.conditioned

    @property
    def loss_by_motion(self) -> bool:
        """Whether an error counts by its share of the loudest component's motion."""
        return self.conditioned

    @property
    def relative_force_loss(self) -> bool:
        """Whether the force error of a run is counted in units of the run's own force, and that of
        the torque in units of its own torque."""
        return self.conditioned

    @property
    def clip_norm(self) -> float | None:
        """Largest norm of the gradient of all weights; None for any."""
        return 1.0 if self.conditioned else None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Network(Settings):
    """The size of the network, and where it starts.

    Attributes:
      latent_size, hidden_layers, message_passing_steps: L, layers per MLP, M (blocks of a mixer).
      zero_decoder: the decoder starts from zero, so that training starts from the mean prediction:
        constant velocity in order 2.
      weight_average: decay of the moving average of the weights that is evaluated and saved; 0 for
        none.
      seed: of weights, batches and noise.
    """

    latent_size: int = number(64, 1, 4096)
    hidden_layers: int = number(2, 1, 32)
    message_passing_steps: int = number(1, 1, 100)
    zero_decoder: bool = False
    weight_average: float = number(0.998, 0, 1)
    seed: int = 0

    def rules(self):
        """Raises where the average would keep the first weights for ever."""
        if self.weight_average == 1:
            raise ValueError('weight_average is 1, must lie in [0, 1): it would keep the start')


@dataclasses.dataclass(frozen=True, kw_only=True)
class SingleSteps(Settings):
    """The first stage of training: single steps from noisy histories.

    Attributes:
      batch_size, num_steps: of this stage.
      copies: so many shifted or mirrored copies of each training run are trained on as well
        (`symmetric_copies`), in both stages.
      noise_std: random-walk noise of the last input step, m/frame or a fraction.
      noise_relative: whether the noise is a fraction of each node's own velocity scale.
      learning_rate, learning_rate_floor, decay_steps: lr decays by 0.1 per `decay_steps` to the
        floor.
    """

    batch_size: int = number(16, 1, 100_000)
    num_steps: int = number(3000, 0)
    copies: int = number(0, 0, 100)
    noise_std: float = number(0.5, 0)
    noise_relative: bool = True
    learning_rate: float = 1e-3
    learning_rate_floor: float = 1e-5
    decay_steps: float = 3000.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Unrolled(Settings):
    """The second stage of training: N steps, with gradients through the rollout.

    Attributes:
      unroll_length, unroll_steps, unroll_batch_size: N, steps and batch of this stage.
      unroll_noise: its noise, as a share of `noise_std`.
      unroll_learning_rate: rate that it starts from.
    """

    unroll_length: int = number(16, 2, 10_000)
    unroll_steps: int = number(2000, 0)
    unroll_batch_size: int = number(8, 1, 100_000)
    unroll_noise: float = 0.0
    unroll_learning_rate: float = 3e-4


@dataclasses.dataclass(frozen=True)
class TrainConfig(Unrolled, SingleSteps, Network, Inputs, Edges, Nodes):
    """Everything that decides what a model is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `methods.registry`.
    """

    preset: str
    model: str = 'gns'

    def rules(self):
        """Raises where parts do not fit each other or the method."""
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
        if not self.state_inputs and self.model != 'mlp':
            raise ValueError(
                f'state_inputs is False with model {self.model!r}: only the MLP does without, '
                f'edges and mixers are made of the state'
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
        if method.on_particles and self.predict_torque:
            raise ValueError(f'predict_torque is for models in a subspace, not for {self.model}')
        if method.on_particles and (self.modes or self.rigid_stride > 1):
            raise ValueError(
                f'{self.model} has no modes and takes the whole body: modes 0, rigid_stride 1'
            )
        if self.gate_weight > 0 and self.gate_steps >= self.num_steps:
            raise ValueError(
                f'gate_steps is {self.gate_steps}, but the gates must close before the end of the '
                f'single-step stage of {self.num_steps} steps'
            )

    @property
    def has_lasting_graph(self) -> bool:
        """Whether the model is a graph network with the same edges in every frame: only then
        rollouts are specialised for them."""
        return registry.get(self.model).has_graph and not self.surface_height
