"""Statistics of a training set, which scale the network's inputs and outputs.

Two families. *Published*: one mean and standard deviation per axis for the whole dataset, from
`metadata.json`, and edge displacements divided by the connectivity radius. *Ours*: every node class
(the rigid body, each mode) has statistics of its own per axis, and so has the displacement of every
pair of classes. Mode scores reach 18 while their steps are 1e-5 to 1e-2; one scale for all of them
would hide most modes from the network.
"""

import dataclasses
from typing import Self

import numpy as np

from learning_to_simulate.axes import speed_of, without_height
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH, TrainConfig
from learning_to_simulate.scene import RigidMotion, Scene, require
from pca_tools.metadata import DIM

# A quieter axis than this share of the class's loudest one counts as still: the lateral motion of a
# symmetric body is exactly zero, and dividing by its round-off would feed noise to the network.
STD_FLOOR = 1e-3
# A spread below this share of a force's size is the rounding of float32 records.
FORCE_ROUNDING = 1e-6
MAX_PLACES = 10_000  # of the surface that a contact is read from


def array(shape: str, optional: bool = False):
    """A field of `Arrays`: its shape as numbers and letters, and whether it may be absent."""
    options = {'default': None} if optional else {}
    return dataclasses.field(**options, metadata={'shape': shape, 'optional': optional})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arrays:
    """Named float64 arrays that know their shapes; None where the scene has no such part."""

    def to_json(self) -> dict:
        """Nested lists of float64, exact under `from_json`."""
        return {k: None if v is None else v.tolist() for k, v in dataclasses.asdict(self).items()}

    @classmethod
    def from_json(cls, values: dict) -> Self:
        return cls(
            **{k: None if v is None else np.asarray(v, np.float64) for k, v in values.items()}
        )

    def check_arrays(self, sizes: dict[str, int], present: dict[str, bool]) -> None:
        """Raises ValueError where an array is missing, of another shape, infinite or of no use;
        `sizes` are of the letters of shapes, `present` says of first words of names whether the
        scene has them."""
        for field in dataclasses.fields(self):
            value, name = getattr(self, field.name), f'statistics.{field.name}'
            wanted = present.get(field.name.split('_')[0])
            if wanted is not None:
                require((value is not None) == wanted, f'presence of {name}', value)
            if value is None:
                require(field.metadata['optional'], name, None)
                continue
            letters = field.metadata['shape'].split()
            shape = tuple(sizes[s] if s in sizes else int(s) for s in letters)
            require(value.shape == shape, f'{name} of shape', value.shape)
            require(bool(np.isfinite(value).all()), name, 'not finite')
            if name.endswith('_std') or field.name == 'body_speed':
                require(bool((value > 0).all()), name, 'not positive')
            if name.endswith('_range'):
                require(bool((value[0] <= value[1]).all()), name, 'upside down')


@dataclasses.dataclass(frozen=True, kw_only=True)
class Covered(Arrays):
    """What the training runs covered: least and greatest of the body and of the context.

    Attributes:
      given_range: of the given coordinates of the rigid particles; None, as the next three, where
        no motion is given. Of a driven body the up component is that of the shape alone.
      given_velocity_range: of the displacement of any given particle.
      body_extent_range: of the extent of the given body in a frame.
      body_speed_range: of the given body's RMS displacement.
      context_range: None without a context.
    """

    given_range: np.ndarray | None = array('2 D', optional=True)
    given_velocity_range: np.ndarray | None = array('2 D', optional=True)
    body_extent_range: np.ndarray | None = array('2 D', optional=True)
    body_speed_range: np.ndarray | None = array('2 1', optional=True)
    context_range: np.ndarray | None = array('2 C', optional=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Statistics(Covered):
    """Statistics by node class: class 0 is the rigid body, class 1 + k is mode k.

    K = 1 + r classes, F components of the force. SI units, velocities and accelerations per frame.

    Attributes:
      origin: mean position; node states are offsets from it.
      displacement_mean, displacement_std: position of the sender minus that of the receiver,
        [receiver, sender].
      target_mean, target_std: of what a node of the class predicts.
      force_mean, force_std: None without a force. Ours: one scale for all axes, since the lateral
        force is noise.
      context_mean, context_std: None without a context.
      log_context_mean, log_context_std: of the logarithm, a second input of our models (loads and
        gravities span decades); None unless all values are positive.
      height_std, height_velocity_std: of the body's height and its change; of a driven body only.
      body_speed: mean RMS displacement of the rigid particles; only where it scales the rate.
      position_range: lowest and highest position.
      path: of `path_memory.PathMemory.of_statistics`; None where the path is no input.
      contact, surface: of `contact.Contact.of_statistics`; None where a body may show its whole
        force everywhere.
    """

    origin: np.ndarray = array('K D')
    position_std: np.ndarray = array('K D')
    velocity_mean: np.ndarray = array('K D')
    velocity_std: np.ndarray = array('K D')
    acceleration_mean: np.ndarray = array('K D')
    acceleration_std: np.ndarray = array('K D')
    displacement_mean: np.ndarray = array('K K D')
    displacement_std: np.ndarray = array('K K D')
    target_mean: np.ndarray = array('K D')
    target_std: np.ndarray = array('K D')
    height_std: np.ndarray | None = array('1', optional=True)
    height_velocity_std: np.ndarray | None = array('1', optional=True)
    body_speed: np.ndarray | None = array('1', optional=True)
    position_range: np.ndarray = array('2 K D')
    force_mean: np.ndarray | None = array('F', optional=True)
    force_std: np.ndarray | None = array('F', optional=True)
    context_mean: np.ndarray | None = array('C', optional=True)
    context_std: np.ndarray | None = array('C', optional=True)
    log_context_mean: np.ndarray | None = array('C', optional=True)
    log_context_std: np.ndarray | None = array('C', optional=True)
    path: np.ndarray | None = array('5', optional=True)
    contact: np.ndarray | None = array('2', optional=True)
    surface: np.ndarray | None = array('P W', optional=True)

    def check(self, scene: Scene) -> None:
        """Raises ValueError where the arrays do not fit the scene or are of no use."""
        context = len(scene.context_names)
        force = DIM  # of one body, or of all together, or of each
        if scene.bodies and self.force_mean is not None and self.force_mean.size > DIM:
            force = DIM * len(scene.bodies)
        places = self.surface.shape[0] if self.surface is not None and self.surface.ndim else 0
        if self.surface is not None:
            require(0 < places <= MAX_PLACES, 'places of statistics.surface', places)
        self.check_arrays(
            {'K': scene.n_modes + 1, 'D': DIM, 'C': context, 'F': force, 'P': places,
             'W': 2 + scene.n_modes * DIM},
            {'force': scene.has_force, 'context': bool(context),
             'contact': self.surface is not None},
        )  # fmt: skip
        prescribed = scene.rigid_motion == RigidMotion.PRESCRIBED and not scene.bodies
        if self.contact is not None:
            ways = set(range(DIM)) - {scene.up_axis}
            require(self.contact[0] in ways, 'axis of statistics.contact', float(self.contact[0]))
            require(prescribed and scene.has_force, 'statistics.contact of the scene', scene.name)


def compute_statistics(groups, metadata, scene: Scene, config: TrainConfig) -> Statistics:
    """Statistics of the training runs (list of `RunGroup`, whose last r nodes are modes) in
    float64; the config decides the family, and the published one comes from the validated metadata.
    ValueError for runs shorter than three frames, or a rate that is scaled with a body at rest."""
    positions = [group.position for group in groups]
    if min(p.shape[1] for p in positions) < 3:  # for an acceleration, x_2 - 2 x_1 + x_0
        raise ValueError('statistics need at least three frames per run')
    r, up = scene.n_modes, scene.up_axis
    velocities = [np.diff(p, axis=1) for p in positions]
    # One origin per class and not per particle: so a body of any R has one.
    origin, position_std = _moments(positions, r)
    values = {'origin': origin, 'position_std': position_std}
    if config.is_published:
        values |= _dataset_wide(metadata, scene, config.noise_std)
    else:
        values['velocity_mean'], values['velocity_std'] = _moments(velocities, r)
        accelerations = [np.diff(v, axis=1) for v in velocities]
        values['acceleration_mean'], values['acceleration_std'] = _moments(accelerations, r)
        values['displacement_mean'], values['displacement_std'] = _displacements(
            positions, origin, r
        )
    # What is predicted: places since the last given frame, displacements, or accelerations.
    since = [p - p[:, INPUT_SEQUENCE_LENGTH - 1 :][:, :1] for p in positions]
    for name, places in zip(('mean', 'std'), _moments(since, r), strict=True):
        orders = places, values[f'velocity_{name}'], values[f'acceleration_{name}']
        body, modes = orders[config.rigid_order][:1], orders[config.mode_order][1:]
        values[f'target_{name}'] = np.concatenate([body, modes])
    if scene.rigid_motion == RigidMotion.DRIVEN:
        heights = [p[:, :, :-r, up].mean(axis=-1) for p in positions]
        values['height_std'] = _changes(heights, 0)[1]
        values['height_velocity_std'] = _changes(heights, 1)[1]
        if not config.is_published:
            # The body's height moves far less than the particles of a turning wheel do.
            mean, std = _changes(heights, config.rigid_order)
            values['target_mean'][0, up], values['target_std'][0, up] = mean[0], std[0]
    if config.rate_scaled and scene.rigid_motion.is_known:
        speeds = [speed_of(v[:, :, :-r])[..., None] for v in velocities]
        values['body_speed'] = np.array([_rows(speeds).mean()])
        if not values['body_speed'] > 0:
            raise ValueError(
                'rate_scaled needs a body that moves, but no rigid particle moves in the training '
                'runs'
            )
    if scene.context_names:
        context = _rows(_contexts(groups))
        values |= _of_context('context', context)
        if not config.is_published and (context > 0).all():
            values |= _of_context('log_context', np.log(context))
    if scene.has_force:
        force = _rows([group.force for group in groups])
        values['force_mean'], values['force_std'] = _of_force(force, metadata, scene, config)
    return Statistics(**values, **ranges(groups, scene))


def node_classes(n_rigid: int, n_modes: int) -> np.ndarray:
    """int [V]: 0 for a rigid particle, 1 + k for mode k."""
    return np.concatenate([np.zeros(n_rigid, np.int32), 1 + np.arange(n_modes, dtype=np.int32)])


def floored(std, largest=None):
    """Standard deviations with still axes raised to a share of the loudest axis (1 where all are
    still)."""
    largest = std.max(axis=-1, keepdims=True) if largest is None else largest
    return np.maximum(std, np.where(largest > 0, STD_FLOOR * largest, 1.0))


def _rows(arrays):
    """[samples, D] of arrays [..., D]."""
    return np.concatenate([a.reshape(-1, a.shape[-1]) for a in arrays])


def _by_class(arrays, n_modes):
    """Samples [n, D] of each class from arrays [S, T, V, D] of runs with any R."""
    rigid = _rows([a[:, :, :-n_modes] for a in arrays])
    modes = [_rows([a[:, :, k - n_modes] for a in arrays]) for k in range(n_modes)]
    return [rigid if len(rigid) else np.zeros((1, arrays[0].shape[-1])), *modes]


def _moments(arrays, n_modes):
    """Mean and standard deviation [K, D] of each class."""
    classes = _by_class(arrays, n_modes)
    mean, std = (np.stack([f(x, axis=0) for x in classes]) for f in (np.mean, np.std))
    return mean, floored(std)


def _changes(heights, order):
    """Mean and standard deviation [1] of the order-th difference of heights [S, T]."""
    rows = np.concatenate([np.diff(h, n=order, axis=1).reshape(-1, 1) for h in heights])
    return np.array([rows.mean()]), floored(rows.std(axis=0))


def _of_context(name, values):
    std = values.std(axis=0)
    return {f'{name}_mean': values.mean(axis=0), f'{name}_std': floored(std, std)}


def _of_force(force, metadata, scene, config):
    """Mean and spread of a force [n, F]."""
    if config.is_published:
        # By component, of the metadata; of several bodies of the runs. Round-off is no spread.
        mean, std = (np.asarray(metadata[f'rigid_body_force_{x}']) for x in ('mean', 'std'))
        if scene.bodies:
            mean, std = force.mean(axis=0), force.std(axis=0)
        return mean, floored(np.where(std > FORCE_ROUNDING * np.abs(mean), std, 0.0))
    # The loudest axis' spread for all axes; 1 for a force that never changes (a body in the air).
    spread = force.std(axis=0).max()
    spread = spread if spread > FORCE_ROUNDING * np.abs(force).max() else 1.0
    return force.mean(axis=0), np.full(force.shape[1], spread)


def _dataset_wide(metadata, scene, noise):
    """Published family: the noise adds in quadrature (Sanchez-Gonzalez et al. 2020)."""
    tiled = {
        key: np.tile(np.asarray(metadata[key], np.float64), (scene.n_modes + 1, 1))
        for key in ('vel_mean', 'vel_std', 'acc_mean', 'acc_std')
    }
    classes, dim = tiled['vel_mean'].shape
    return {
        'velocity_mean': tiled['vel_mean'],
        'velocity_std': np.hypot(floored(tiled['vel_std']), noise),
        'acceleration_mean': tiled['acc_mean'],
        'acceleration_std': np.hypot(floored(tiled['acc_std']), noise),
        # The published feature is the absolute displacement: offsets get the origins back.
        'displacement_mean': np.zeros((classes, classes, dim)),
        'displacement_std': np.full((classes, classes, dim), scene.connectivity_radius),
    }


def _displacements(positions, origin, n_modes):
    """Mean and std [K, K, D] of x_sender - x_receiver, from moments; all rigid particles count."""
    n_class, dim = origin.shape
    total = np.zeros((n_class, n_class, dim))
    square = np.zeros_like(total)
    count = np.zeros((n_class, n_class, 1))
    for p in positions:
        node_class = node_classes(p.shape[2] - n_modes, n_modes)
        # Moments of offsets, not of positions: E[d^2] - E[d]^2 loses no digits to the origins,
        # which are added back to the mean at the end.
        offset = p - origin[node_class]
        for i, receiver in enumerate(node_class):  # one at a time keeps the memory small
            difference = offset - offset[:, :, i : i + 1]
            for j in range(n_class):
                d = difference[:, :, node_class == j]
                total[receiver, j] += d.sum(axis=(0, 1, 2))
                square[receiver, j] += (d**2).sum(axis=(0, 1, 2))
                count[receiver, j] += d[..., 0].size
    count = np.maximum(count, 1)
    mean = total / count
    std = np.sqrt(np.maximum(square / count - mean**2, 0.0))
    return mean + origin[None, :] - origin[:, None], floored(std)


def _contexts(groups):
    """[..., C] of groups; where one changes in time, all count by frame."""
    if any(group.context_changes for group in groups):
        return [group.context_by_frame for group in groups]
    return [group.context for group in groups]


def ranges(groups, scene) -> dict[str, np.ndarray]:
    """Least and greatest of what the training runs covered, whatever the model is: the arrays of
    `Statistics` whose names end so."""
    positions = [group.position for group in groups]
    classes = _by_class(positions, scene.n_modes)
    ends = [[f(samples, axis=0) for samples in classes] for f in (np.min, np.max)]
    found = {'position_range': np.stack(ends)}

    def add(name, arrays):
        rows = _rows(arrays)
        found[f'{name}_range'] = np.stack([rows.min(axis=0), rows.max(axis=0)])

    if scene.rigid_motion.is_known:
        bodies = [p[:, :, : -scene.n_modes] for p in positions]
        if scene.rigid_motion == RigidMotion.DRIVEN:  # the height is not given
            bodies = [without_height(body, scene.up_axis) for body in bodies]
        moves = [np.diff(body, axis=1) for body in bodies]
        add('given', bodies)
        add('given_velocity', moves)
        add('body_extent', [np.ptp(body, axis=2) for body in bodies])
        add('body_speed', [speed_of(move)[..., None] for move in moves])
    if scene.context_names:
        add('context', _contexts(groups))
    return found
