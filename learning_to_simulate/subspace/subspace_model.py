"""`Model`: a simulator in the subspace with its edges, and how one is read from its folder."""

import dataclasses

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH, TrainConfig
from learning_to_simulate.connectivity_utils import build
from learning_to_simulate.live import soil
from learning_to_simulate.normalization import Statistics
from learning_to_simulate.scene import MAX_RIGID, is_int, require
from learning_to_simulate.subspace import path_memory
from learning_to_simulate.subspace.learned_simulator import Layout, LearnedSimulator, SimulatorState
from learning_to_simulate.subspace.rigid_body import KnownMotion
from learning_to_simulate.subspace.whole_state import WholeStateSimulator
from pca_tools.subspace import Subspace


def make_simulator(scene, config, statistics, particle_types) -> LearnedSimulator:
    """A simulator with fresh weights; arguments as of `LearnedSimulator`."""
    make = LearnedSimulator if config.has_graph else WholeStateSimulator
    return make(scene, config, statistics, particle_types)


@dataclasses.dataclass
class Model:
    """A simulator with what is needed to run it on graphs of any number of rigid particles.

    Attributes:
      mode_mask: bool [r, r] of the mode -> mode edges, completed by Algorithm 2; else None.
      loaded_mask: bool [V, V] from an edge file, used as it is; else None.
      edge_source: where the edges come from; None if the model folder does not say.
    """

    simulator: LearnedSimulator
    mode_mask: np.ndarray | None
    loaded_mask: np.ndarray | None
    edge_source: str | None = None

    def __post_init__(self):
        self._layouts = {}

    def layout(self, n_rigid: int) -> Layout:
        """The graph for R rigid particles, built once; ValueError if the model's edges do not fit
        it."""
        if n_rigid not in self._layouts:
            s = self.simulator
            s.check_size(n_rigid)
            mask = build(s.config.adjacency, s.scene, n_rigid, self.mode_mask, self.loaded_mask)
            self._layouts[n_rigid] = Layout(mask, n_rigid, s.scene, s.statistics, s.config)
        return self._layouts[n_rigid]

    def edge_counts(self) -> dict[str, int]:
        """Number of edges of every graph that was built, by its R."""
        return {str(n): layout.n_edge for n, layout in self._layouts.items()}

    def fix_mode_edges(self, mode_mask: np.ndarray) -> None:
        """Takes the mode -> mode edges that gates have learned, bool [receiver, sender] [r, r];
        graphs are built anew."""
        self.mode_mask, self.edge_source = mode_mask, 'learned gates'
        sizes, self._layouts = list(self._layouts), {}
        for n_rigid in sizes:
            self.layout(n_rigid)

    def fitting_subspace(self, subspace: Subspace) -> Subspace:
        """The modes of a dataset's subspace that the model predicts: all, or the first ones;
        ValueError if it has other modes or particles than the model's."""
        scene, first = self.simulator.scene, self.simulator.config.modes
        if first and subspace.n_modes > first:
            subspace = dataclasses.replace(subspace, components=subspace.components[:, :first])
        found, wanted = (subspace.n_modes, subspace.n_soil), (scene.n_modes, scene.n_soil)
        if found[0] != wanted[0] or wanted[1] not in (None, found[1]):
            raise ValueError(
                f'the subspace has {found[0]} modes of {found[1]} particles, the model was trained '
                f'on {wanted[0]} modes of {wanted[1]}'
            )
        return subspace

    def decoder(self, subspace: Subspace | None) -> soil.Decoder | None:
        """Turns modes into particles; errors as of `fitting_subspace`."""
        if subspace is None:
            return None
        return soil.Decoder(self.fitting_subspace(subspace), self.simulator.scene.up_axis)

    def create_variables(self, n_rigid: int):
        """Makes all variables by running one frame of zeros; their values follow TensorFlow's
        seed, which whoever trains sets. Setting it throws all kernels away, so loading does not."""
        s, layout = self.simulator, self.layout(n_rigid)
        state = SimulatorState(
            tf.zeros([1, layout.n_node, s.dim]),
            tf.zeros([1, layout.n_node, INPUT_SEQUENCE_LENGTH - 1, s.dim]),
        )
        body, start = tf.zeros([1, n_rigid, s.dim]), tf.zeros([1, s.scene.n_modes, s.dim])
        known = KnownMotion(body, body, tf.zeros([1, path_memory.WIDTH]), start)
        s.predict(state, known, tf.zeros([1, len(s.scene.context_names)]), layout)


def load(path: str) -> Model:
    """Loads a model for evaluation; FileNotFoundError, ValueError: no model there, a field of
    config.json that is missing, unknown, of another type or fits no model, or weights of another.
    No variable is made that the weights do not hold."""
    values = checkpoints.read_config(path)
    with checkpoints.refusing_wrong_fields(path):
        config, scene, types = checkpoints.settings_and_scene(values, TrainConfig)
        statistics = Statistics.from_json(values['statistics'])
        statistics.check(scene)
        n_rigid, source = values['n_rigid'], values.get('edge_source')
        require(is_int(n_rigid, 0, MAX_RIGID), 'n_rigid', n_rigid)
        require(isinstance(source, str | None), 'edge_source', source)
        masks = [_mask(values[key], key) for key in ('mode_mask', 'loaded_mask')]

    def make():
        model = Model(make_simulator(scene, config, statistics, types), *masks, source)
        model.create_variables(n_rigid)
        return model

    return checkpoints.filled(path, make)


def _mask(value, name):
    if value is None:
        return None
    mask = np.array(value)
    is_square = mask.ndim == 2 and mask.shape[0] == mask.shape[1] and mask.dtype.kind == 'i'
    require(is_square and np.isin(mask, (0, 1)).all(), name, 'not a square of 0 and 1')
    return mask.astype(bool)
