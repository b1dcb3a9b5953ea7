"""Settings: everything that decides what a trained simulator is.

Settings are frozen values that check themselves. They are stored beside the weights, so that no
flag can change the meaning of weights.
"""

import dataclasses

from learning_to_simulate.scene import MAX_MODES, MAX_RIGID

INPUT_SEQUENCE_LENGTH = 6  # H, as in Sanchez-Gonzalez et al. 2020
LARGEST = 2**62
GRAPH_NETWORK = 'gns'
STYLES = ('ours', 'published')
MODELS = (GRAPH_NETWORK, 'mlp', 'mixer_se', 'mixer_scse')  # of a `TrainConfig`


def number(default, low=-LARGEST, high=LARGEST):
    """A setting with its least and largest value; the largest are beyond any network of the
    project."""
    return dataclasses.field(default=default, metadata={'range': (low, high)})


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings that check their types, their ranges, and by a method `rules` of theirs whether they
    fit each other."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value, kind = getattr(self, field.name), field.type
            # JSON and command lines may write a whole number for a float.
            kinds = (int, float) if kind is float else kind
            is_truth = isinstance(value, bool)
            if not isinstance(value, kinds) or is_truth != (kind is bool):
                name = getattr(kind, '__name__', kind)
                raise ValueError(f'{field.name} is {value!r}, must be of type {name}')
            low, high = field.metadata.get('range', (-LARGEST, LARGEST))
            if kind in (int, float) and not low <= value <= high:  # false for NaN as well
                raise ValueError(
                    f'{field.name} is {value!r}, must be at least {low:g} and at most {high:g}'
                )
        for part in type(self).__mro__:
            if 'rules' in vars(part):
                part.rules(self)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Training(Settings):
    """The size of a network, and how it is trained in single steps from noisy histories.

    Attributes:
      latent_size, hidden_layers, message_passing_steps: L, layers per MLP, M (blocks of a mixer).
      weight_average: decay of the moving average of the weights that is evaluated and saved; 0 for
        none.
      seed: of weights, batches and noise.
      batch_size: of this stage.
      num_steps: of all stages.
      noise_std: random-walk noise of the last input step, a fraction of each node's own velocity
        scale; of the published style m/frame.
      learning_rate, learning_rate_floor, decay_steps: the rate decays by 0.1 per `decay_steps` to
        the floor.
    """

    latent_size: int = number(64, 1, 4096)
    hidden_layers: int = number(2, 1, 32)
    message_passing_steps: int = number(1, 1, 100)
    weight_average: float = number(0.998, 0, 1)
    seed: int = 0
    batch_size: int = number(16, 1, 100_000)
    num_steps: int = number(5000, 0)
    noise_std: float = number(0.5, 0)
    learning_rate: float = 1e-3
    learning_rate_floor: float = 1e-5
    decay_steps: float = 3000.0

    def rules(self):
        """Raises where the average would keep the first weights for ever."""
        if self.weight_average == 1:
            raise ValueError('weight_average is 1, must lie in [0, 1): it would keep the start')

    @property
    def single_steps(self) -> int:
        """Of the first stage."""
        return self.num_steps - getattr(self, 'unroll_steps', 0)


@dataclasses.dataclass(frozen=True)
class TrainConfig(Training):
    """Everything that decides what a model in the subspace is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: one of `MODELS`.
      copies: shifted or mirrored copies of each training run that are trained on as well
        (`symmetric_copies`), in both stages.
      rigid_particles: number of rigid particles that are nodes, the lowest ones of the first frame;
        0 keeps all. Only where the motion is prescribed: a blade cuts with its lower edge, and the
        rest follows from it.
      modes: number of modes that are nodes, the first ones of the dataset; the others are 0 in
        every prediction and count in every error. 0 keeps all.
      adjacency: which node acts on which: 'fully_connected'; 'algorithm2' (its mode block from
        `edges.json` of the dataset where there is one, else ranked by correlation); 'correlation'
        (always ranked); 'random' (by lot, from the seed); the edge file that was loaded; 'none' for
        a model without a graph.
      mode_edges: mode -> mode edges that are kept when they are ranked by correlation or drawn.
      gate_weight: above 0 the mode -> mode edges are learned together with the simulator, one
        hard-concrete gate each, and this is the price of all of them being open (`edge_gates`).
      gate_steps: the step after which the gates close for good; edges that are more likely open
        than not stay.
      style: 'ours' or 'published' (Haeri & Skonieczny 2021, Usmani & Skonieczny 2023). Published
        models see velocities and particle types alone, scaled by the statistics of the whole
        dataset, edges in connectivity radii; they sum messages, weigh all errors alike, clip no
        gradient, and predict every particle of a body whose height alone is not given. Ours
        scale every node class and pair of classes by its own statistics, see positions,
        accelerations, the given motion of the coming frame and an embedding of each mode;
        they take the mean of messages, weigh an error by its share of the motion, count the force
        of a run in units of its own, give none to a tool clear of the soil, and clip gradients.
      velocity_inputs: number of the H - 1 last velocities that are inputs.
      rate_scaled: velocities in and displacements out are counted per displacement of the body in
        the coming frame (soil at these speeds is nearly rate-independent); needs a known motion and
        order 1.
      mode_order, rigid_order: 2 predicts acceleration, 1 predicts the displacement of the frame; 0
        (modes of the MLP only) predicts where they are, counted from the last given frame. Then a
        frame follows from what the tool has done since the start of the run (`path_memory`) and
        not from the state, so that no error is carried on; needs a body of given motion.
      unroll_length, unroll_batch_size, unroll_steps: the second stage of training, the last
        `unroll_steps` of `num_steps`: rollouts of that length without noise, and gradients through
        them.
    """

    preset: str
    model: str = GRAPH_NETWORK
    copies: int = number(0, 0, 100)
    rigid_particles: int = number(10, 0, MAX_RIGID)
    modes: int = number(0, 0, MAX_MODES)
    adjacency: str = 'algorithm2'
    mode_edges: int = number(28, 0, MAX_MODES**2)
    gate_weight: float = number(0.0, 0)
    gate_steps: int = number(1000, 1)
    style: str = 'ours'
    velocity_inputs: int = number(1, 1, INPUT_SEQUENCE_LENGTH - 1)
    rate_scaled: bool = True
    mode_order: int = number(1, 0, 2)
    rigid_order: int = number(1, 1, 2)
    unroll_length: int = number(16, 2, 10_000)
    unroll_steps: int = number(2000, 0)
    unroll_batch_size: int = number(8, 1, 100_000)

    def rules(self):
        """Raises where settings do not fit each other or the network."""
        graph = f'with model {self.model!r}'
        orders = f'mode_order {self.mode_order} and rigid_order {self.rigid_order}'
        for is_wrong, why in (
            (self.model not in MODELS,
             f'model is {self.model!r}, must be one of {", ".join(MODELS)}'),
            (self.style not in STYLES,
             f'style is {self.style!r}, must be one of {", ".join(STYLES)}'),
            ((self.adjacency == 'none') == self.has_graph,
             f'adjacency is {self.adjacency!r} {graph}: gns needs one, the others take none'),
            (self.gate_weight > 0 and self.adjacency != 'algorithm2',
             f'gate_weight {self.gate_weight} learns the edges, but adjacency {self.adjacency!r} '
             'gives them: leave one of them out'),
            (self.unroll_steps > self.num_steps,
             f'unroll_steps is {self.unroll_steps}, more than all {self.num_steps} num_steps'),
            (self.gate_weight > 0 and self.gate_steps >= self.single_steps,
             f'gate_steps is {self.gate_steps}, but the gates must close before the end of the '
             f'single-step stage of {self.single_steps} steps'),
            (self.reads_path and (self.model != 'mlp' or self.is_published),
             f'mode_order is 0 {graph}, style {self.style!r}: only an MLP of the style ours does '
             'without the state of the soil'),
            (self.rate_scaled and (self.mode_order, self.rigid_order) != (1, 1),
             f'rate_scaled needs mode_order and rigid_order 1, not {orders}: an acceleration does '
             'not scale with the rate'),
        ):  # fmt: skip
            if is_wrong:
                raise ValueError(why)

    @property
    def nodes(self) -> dict[str, int]:
        """Arguments of `reading_utils.read_groups`."""
        return {name: getattr(self, name) for name in ('rigid_particles', 'modes')}

    @property
    def reads_path(self) -> bool:
        """Whether a frame follows from the path of the tool alone; see `mode_order`."""
        return self.mode_order == 0

    @property
    def is_published(self) -> bool:
        return self.style == 'published'

    @property
    def has_graph(self) -> bool:
        return self.model == GRAPH_NETWORK


@dataclasses.dataclass(frozen=True)
class FullSpaceConfig(Training):
    """What a graph network on thinned particles is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: full_space.
      soil_particles: about how many soil particles are kept.
      velocity_inputs, rate_scaled: as of `TrainConfig`.
    """

    preset: str
    model: str = 'full_space'
    soil_particles: int = number(400, 1)
    velocity_inputs: int = number(1, 1, INPUT_SEQUENCE_LENGTH - 1)
    rate_scaled: bool = True


@dataclasses.dataclass(frozen=True)
class PathRidgeConfig(Settings):
    """What a regression on the path is.

    Attributes:
      preset: name of the preset the config started from.
      model: path_ridge.
      max_samples: frames of training that it is fitted to, spread over all runs.
      leave_one_out: whether it is fitted to train and valid together, chosen by each of their runs,
        judging what the others give, and averaged over the ten best with each kernel: for data of
        a dozen runs.
    """

    preset: str
    model: str = 'path_ridge'
    max_samples: int = number(3000, 1, 20_000)
    leave_one_out: bool = False
