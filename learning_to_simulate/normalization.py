"""Statistics of a training set, and the affine maps that the network's inputs and outputs go
through.

Two families. *Published*, dataset-wide: one mean and standard deviation per axis from
`metadata.json`, edge displacement divided by the connectivity radius. *Ours*: every node
class (the rigid body, each mode) has its own statistics per axis, and every pair of classes its own
displacement statistics; mode scores reach 18 while their steps are 1e-5..1e-2, so one scale for all
hides most modes from the network.
"""

import dataclasses

import numpy as np

from learning_to_simulate.body_height import height_of, without_height
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH, TrainConfig
from learning_to_simulate.scene import RigidMotion, Scene, require

# A quieter axis than this share of the class's loudest one counts as still: the lateral motion of a
# symmetric body is exactly zero, and dividing by its round-off would feed noise to the network.
STD_FLOOR = 1e-3
# A spread below this share of a force's size is the rounding of float32 records.
FORCE_ROUNDING = 1e-6
MAX_PLACES = 10_000  # of the surface that a contact is read from


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Means and standard deviations by node class; class 0 is the rigid body, class 1 + k is mode
    k.

    Attributes:
      origin: [1 + r, D] mean position, m; node states are offsets from it.
      position_std: [1 + r, D], m.
      velocity_mean, velocity_std, acceleration_mean, acceleration_std: [1 + r, D], per frame.
      displacement_mean, displacement_std: [1 + r, 1 + r, D], sender minus receiver, [receiver,
        sender].
      force_mean, force_std: [D], N; None without a force. Ours: one scale for all axes,
        since the lateral force is noise.
      torque_mean, torque_std: [D], N m, likewise; None where the torque is not predicted.
      context_mean, context_std: [C]; None without a context.
      log_context_mean, log_context_std: [C] of the logarithm, a second input of our models
        (loads and gravities span decades); None unless all values are positive.
      target_mean, target_std: [1 + r, D] of what a node of the class predicts, per frame.
      height_std, height_velocity_std: [1] of the body's height, m, and its change per frame; only
        where the motion is driven.
      body_speed: [1] mean RMS displacement of the rigid particles, m/frame; only where it scales
        the rate.
      position_range: [2, 1 + r, D] lowest and highest position, m.
      given_range: [2, D] lowest and highest given coordinate of the rigid particles, m (see
        `given_body`); None, as the next three, where no motion is given.
      given_velocity_range: [2, D] of the displacement of any given particle, m/frame.
      body_extent_range: [2, D] of the extent of the given body in a frame, m.
      body_speed_range: [2, 1] of the given body's RMS displacement, m/frame.
      context_range: [2, C]; None without a context.
      path: [5] of `path_memory.PathMemory.of_statistics`; None where the path is no input.
      contact, surface: [2] and [P, 2 + r D] of `contact.Contact.of_statistics`; None where a body
        may show its whole force everywhere.
    """

    origin: np.ndarray
    position_std: np.ndarray
    velocity_mean: np.ndarray
    velocity_std: np.ndarray
    acceleration_mean: np.ndarray
    acceleration_std: np.ndarray
    displacement_mean: np.ndarray
    displacement_std: np.ndarray
    target_mean: np.ndarray
    target_std: np.ndarray
    height_std: np.ndarray | None
    height_velocity_std: np.ndarray | None
    body_speed: np.ndarray | None
    position_range: np.ndarray
    given_range: np.ndarray | None
    given_velocity_range: np.ndarray | None
    body_extent_range: np.ndarray | None
    body_speed_range: np.ndarray | None
    context_range: np.ndarray | None
    force_mean: np.ndarray | None
    force_std: np.ndarray | None
    context_mean: np.ndarray | None
    context_std: np.ndarray | None
    log_context_mean: np.ndarray | None
    log_context_std: np.ndarray | None
    path: np.ndarray | None = None
    contact: np.ndarray | None = None
    surface: np.ndarray | None = None
    torque_mean: np.ndarray | None = None
    torque_std: np.ndarray | None = None

    def to_json(self) -> dict:
        """Nested lists of float64, exact under `from_json`."""
        return {k: None if v is None else v.tolist() for k, v in dataclasses.asdict(self).items()}

    @classmethod
    def from_json(cls, values: dict) -> 'Statistics':
        """Rebuilds the statistics of `to_json`."""
        return cls(
            **{k: None if v is None else np.asarray(v, np.float64) for k, v in values.items()}
        )

    def check(self, scene: Scene, predict_torque: bool = False) -> None:
        """Raises ValueError where an array is missing, of another shape, infinite or not of use.

        Args:
          scene: that the model is of.
          predict_torque: whether the model predicts it.
        """
        classes, context = scene.n_modes + 1, len(scene.context_names)
        dim = self.origin.shape[-1] if self.origin.ndim else 0
        require(dim in (2, 3), 'statistics.origin of shape', self.origin.shape)
        force = dim  # of one body, or of all together, or of each
        if scene.bodies and self.force_mean is not None and self.force_mean.size > dim:
            force = dim * len(scene.bodies)
        shapes = {
            'displacement_mean': (classes, classes, dim),
            'displacement_std': (classes, classes, dim),
            'force_mean': (force,), 'force_std': (force,),
            'torque_mean': (dim,), 'torque_std': (dim,),
            'height_std': (1,), 'height_velocity_std': (1,), 'path': (5,), 'contact': (2,),
            'body_speed': (1,), 'context_mean': (context,), 'context_std': (context,),
            'log_context_mean': (context,), 'log_context_std': (context,),
            'position_range': (2, classes, dim), 'given_range': (2, dim),
            'given_velocity_range': (2, dim),
            'body_extent_range': (2, dim), 'body_speed_range': (2, 1),
            'context_range': (2, context),
        }  # fmt: skip
        if self.surface is not None:
            places = self.surface.shape[0] if self.surface.ndim else 0
            require(0 < places <= MAX_PLACES, 'places of statistics.surface', places)
            shapes['surface'] = (places, 2 + scene.n_modes * dim)
        contact, surface = self.contact is not None, self.surface is not None
        require(contact == surface, 'presence of statistics.contact', contact)
        if contact:
            axis = float(self.contact.flat[0]) if self.contact.size else None
            ways = set(range(dim)) - {scene.up_axis}
            require(axis in ways, 'axis of statistics.contact', axis)
            prescribed = scene.rigid_motion == RigidMotion.PRESCRIBED and not scene.bodies
            require(prescribed and scene.has_force, 'statistics.contact of the scene', scene.name)
        for field in dataclasses.fields(self):
            value, name = getattr(self, field.name), f'statistics.{field.name}'
            if value is None:
                require(type(None) in getattr(field.type, '__args__', ()), field.name, None)
                continue
            expected = shapes.get(field.name, (classes, dim))
            require(value.shape == expected, f'{name} of shape', value.shape)
            require(bool(np.isfinite(value).all()), name, 'not finite')
            if name.endswith('_std') or field.name == 'body_speed':
                require(bool((value > 0).all()), name, 'not positive')
            if name.endswith('_range'):
                require(bool((value[0] <= value[1]).all()), name, 'upside down')
        has_load = scene.has_force and not scene.bodies
        require(has_load or not predict_torque, 'predict_torque', predict_torque)
        wanted = {'force': scene.has_force, 'torque': predict_torque, 'context': bool(context)}
        for name, present in wanted.items():
            for end in ('mean', 'std'):
                value, field = getattr(self, f'{name}_{end}'), f'statistics.{name}_{end}'
                require((value is not None) == present, f'presence of {field}', value)


def _floored(std, largest=None):
    """Standard deviations with still axes raised to a share of the loudest axis (1 where all are
    still)."""
    largest = std.max(axis=-1, keepdims=True) if largest is None else largest
    floor = np.where(largest > 0, STD_FLOOR * largest, 1.0)
    return np.maximum(std, floor)


def _by_class(arrays, n_modes):
    """Pools arrays [S, T, V, D] of runs with any R into per-class samples: list of [samples, D]."""
    rigid = [a[:, :, :-n_modes].reshape(-1, a.shape[-1]) for a in arrays]
    classes = (
        [np.concatenate(rigid)] if sum(map(len, rigid)) else [np.zeros((1, arrays[0].shape[-1]))]
    )
    return classes + [
        np.concatenate([a[:, :, k - n_modes].reshape(-1, a.shape[-1]) for a in arrays])
        for k in range(n_modes)
    ]


def compute_statistics(
    positions, forces, contexts, metadata, scene: Scene, config: TrainConfig, torques=None
) -> Statistics:
    """Statistics of the training runs in float64.

    Args:
      positions: list of float64 [S, T, V, D], one per rigid node count; the last r nodes are modes.
      forces: list of [S, T, D], or None.
      contexts: list of [S, C] or [S, T, C], or None; all of one kind.
      metadata: validated metadata; the published presets take their statistics from it.
      scene: the scene.
      config: decides the family.
      torques: list of [S, T, D], or None where the torque is not predicted.

    Raises:
      ValueError: if a run is shorter than three frames.
    """
    # An acceleration needs three frames: x_2 - 2 x_1 + x_0.
    if min(p.shape[1] for p in positions) < 3:
        raise ValueError('statistics need at least three frames per run')
    r = scene.n_modes
    samples = _by_class(positions, r)
    # The origin is one point per class and not per particle, so that a body of any R has one; the
    # state holds what is left of a position without it, in float32.
    origin = np.stack([s.mean(axis=0) for s in samples])
    velocities = [np.diff(p, axis=1) for p in positions]
    loads = {
        'force': _rows(forces) if scene.has_force else None,
        'torque': None if torques is None else _rows(torques),
    }
    context = _rows(contexts) if scene.context_names else None
    # A driven body has one free coordinate: its statistics are those of a scalar series [S, T].
    heights = None
    if scene.rigid_motion == RigidMotion.DRIVEN:
        heights = [height_of(p[:, :, :-r], scene.up_axis) for p in positions]
    rate_scaled = config.rate_scaled and scene.rigid_motion.is_known
    values = {
        'origin': origin,
        'position_std': _floored(np.stack([s.std(axis=0) for s in samples])),
        'height_std': _height_std(heights, 0),
        'height_velocity_std': _height_std(heights, 1),
        'body_speed': _body_speed(velocities, r) if rate_scaled else None,
        'context_mean': None if context is None else context.mean(axis=0),
        'context_std': None
        if context is None
        else _floored(context.std(axis=0), context.std(axis=0)),
    }
    # Loads and gravities span decades: a network sees both x and log x of a positive context.
    logarithm = not config.is_published and context is not None and (context > 0).all()
    for name, function in (('mean', np.mean), ('std', np.std)):
        values[f'log_context_{name}'] = function(np.log(context), axis=0) if logarithm else None
    if logarithm:
        values['log_context_std'] = _floored(values['log_context_std'], values['log_context_std'])
    values |= (
        _dataset_wide(metadata, scene, config, origin)
        if config.is_published
        else _by_node_class(positions, velocities, origin, r)
    )
    for name, load in loads.items():
        if load is None:
            moments = None, None
        elif config.is_published:
            moments = _load_wide(name, load, metadata, scene)
        else:
            moments = load.mean(axis=0), np.full(load.shape[1], _load_spread(load))
        values |= dict(zip((f'{name}_mean', f'{name}_std'), moments, strict=True))
    ranges = training_ranges(positions, contexts, scene)
    targets = _targets(values, _places(positions, r), heights, scene, config)
    return Statistics(**values, **targets, **ranges)


def _rows(arrays):
    """[samples, D] of arrays [S, T, D]."""
    return np.concatenate([a.reshape(-1, a.shape[-1]) for a in arrays])


def training_ranges(positions, contexts, scene: Scene) -> dict[str, np.ndarray | None]:
    """The ranges of `Statistics`: what the training runs covered, whatever the model is.

    Args:
      positions: list of float64 [S, T, V, D].
      contexts: list of [S, C] or [S, T, C], or None.
      scene: says what of the body's motion is given.
    """
    ranges: dict = dict.fromkeys(
        (
            'given_range',
            'given_velocity_range',
            'body_extent_range',
            'body_speed_range',
            'context_range',
        )
    )
    ranges['position_range'] = np.stack(
        [[f(s, axis=0) for s in _by_class(positions, scene.n_modes)] for f in (np.min, np.max)]
    )
    bodies = [given_body(p, scene) for p in positions]
    if bodies[0] is not None:
        extents, speeds = zip(*map(body_measures, bodies))
        ranges['given_range'] = _range(bodies)
        ranges['given_velocity_range'] = _range([np.diff(body, axis=1) for body in bodies])
        ranges['body_extent_range'] = _range(extents)
        ranges['body_speed_range'] = _range(speeds)
    if scene.context_names:
        ranges['context_range'] = _range(contexts)
    return ranges


def _range(arrays):
    """[2, F] least and greatest of arrays [..., F]."""
    flat = _rows(arrays)
    return np.stack([flat.min(axis=0), flat.max(axis=0)])


def given_body(positions, scene: Scene):
    """The given part of the rigid particles' positions [S, T, R, D], or None where none is given.

    Where the motion is driven the height is not given: the up component then holds the shape only.
    """
    if not scene.rigid_motion.is_known:
        return None
    body = positions[:, :, : -scene.n_modes]
    if scene.rigid_motion == RigidMotion.DRIVEN:
        body = without_height(body, scene.up_axis)
    return body


def body_measures(body):
    """Extent [S, T, D] and RMS displacement [S, T - 1, 1] of given bodies [S, T, R, D]."""
    speed = np.sqrt((np.diff(body, axis=1) ** 2).sum(axis=-1).mean(axis=-1))
    return np.ptp(body, axis=2), speed[..., None]


def _body_speed(velocities, n_modes):
    """[1] mean over frames of the rigid particles' RMS displacement, m/frame."""
    speeds = [
        np.sqrt((v[:, :, :-n_modes] ** 2).sum(axis=-1).mean(axis=-1)).reshape(-1)
        for v in velocities
    ]
    mean = np.concatenate(speeds).mean()
    if not mean > 0:
        raise ValueError(
            'rate_scaled needs a body that moves, but no rigid particle moves in the training runs'
        )
    return np.array([mean])


def _height_std(heights, order):
    """[1] standard deviation of the order-th difference of the heights [S, T] of each group of
    runs."""
    if heights is None:
        return None
    return _floored(
        np.concatenate([np.diff(h, n=order, axis=1).reshape(-1, 1) for h in heights]).std(axis=0)
    )


def _by_node_class(positions, velocities, origin, r):
    """Our family: statistics of each node class and each pair of classes."""
    velocity_classes = _by_class(velocities, r)
    acceleration_classes = _by_class([np.diff(v, axis=1) for v in velocities], r)
    displacement_mean, displacement_std = _displacements(positions, origin, r)
    return {
        'velocity_mean': np.stack([v.mean(axis=0) for v in velocity_classes]),
        'velocity_std': _floored(np.stack([v.std(axis=0) for v in velocity_classes])),
        'acceleration_mean': np.stack([a.mean(axis=0) for a in acceleration_classes]),
        'acceleration_std': _floored(np.stack([a.std(axis=0) for a in acceleration_classes])),
        'displacement_mean': displacement_mean,
        'displacement_std': _floored(displacement_std),
    }


def _load_spread(load):
    """The loudest axis' standard deviation, N or N m, which all axes share; of a load that never
    changes (a body in the air), which has no spread to count in, 1."""
    spread = load.std(axis=0).max()
    return spread if spread > FORCE_ROUNDING * np.abs(load).max() else 1.0


def _places(positions, n_modes):
    """Mean and std of where each class is, counted from the last given frame of its run."""
    since = [p - p[:, INPUT_SEQUENCE_LENGTH - 1 :][:, :1] for p in positions]
    places = _by_class(since, n_modes)
    return {
        'mean': np.stack([p.mean(axis=0) for p in places]),
        'std': _floored(np.stack([p.std(axis=0) for p in places])),
    }


def _targets(values, places, heights, scene, config):
    """Statistics of what is predicted: place since the start (order 0), displacement (order 1) or
    acceleration (order 2) of each class."""
    target = {}
    for name in ('mean', 'std'):
        by_order = {
            0: places[name],
            1: values[f'velocity_{name}'],
            2: values[f'acceleration_{name}'],
        }
        target[f'target_{name}'] = np.concatenate(
            [by_order[config.rigid_order][:1], by_order[config.mode_order][1:]]
        )
    if heights is not None and not config.is_published:
        # The body's height moves far less than the particles of a turning wheel do.
        change = np.concatenate(
            [np.diff(h, n=config.rigid_order, axis=1).reshape(-1, 1) for h in heights]
        )
        target['target_mean'][0, scene.up_axis] = change.mean()
        target['target_std'][0, scene.up_axis] = _floored(change.std(axis=0))[0]
    return target


def _dataset_wide(metadata, scene, config, origin):
    """Published family: metadata statistics, noise added in quadrature (SG 2020), displacement /
    radius."""
    n_class = len(origin)
    noise = config.noise_std

    def tile(key):
        return np.tile(np.asarray(metadata[key], np.float64), (n_class, 1))

    shape = (n_class, n_class, origin.shape[-1])
    return {
        'velocity_mean': tile('vel_mean'),
        'velocity_std': np.hypot(_floored(tile('vel_std')), noise),
        'acceleration_mean': tile('acc_mean'),
        'acceleration_std': np.hypot(_floored(tile('acc_std')), noise),
        # The published feature is the absolute displacement: offsets get the origins back.
        'displacement_mean': np.zeros(shape),
        'displacement_std': np.full(shape, scene.connectivity_radius),
    }


def _load_wide(name, load, metadata, scene):
    """Mean and spread of a load by component, from the metadata; of several bodies from the
    runs."""
    mean, std = (np.asarray(metadata[f'rigid_body_{name}_{x}']) for x in ('mean', 'std'))
    if scene.bodies:
        mean, std = load.mean(axis=0), load.std(axis=0)
    std = np.where(std > FORCE_ROUNDING * np.abs(mean), std, 0.0)  # round-off is no spread
    return mean, _floored(std)


def _displacements(positions, origin, n_modes):
    """Mean and std of x_sender - x_receiver per pair of classes, [1 + r, 1 + r, D], exact from
    moments.

    The pair of a rigid particle with a mode pools all rigid particles; the pair of two rigid
    particles pools all pairs of them.
    """
    n_class = n_modes + 1
    dim = origin.shape[-1]
    total = np.zeros((n_class, n_class, dim))
    square = np.zeros_like(total)
    count = np.zeros((n_class, n_class, 1))
    for p in positions:
        n_rigid = p.shape[2] - n_modes
        node_class = node_classes(n_rigid, n_modes)
        # Moments of offsets, not of positions: E[d^2] - E[d]^2 loses no digits to the origins,
        # which are added back to the mean at the end.
        offset = p - origin[node_class]
        for i in range(p.shape[2]):  # receiver by receiver keeps the memory at one position array
            difference = offset - offset[:, :, i : i + 1]
            for j in range(n_class):
                d = difference[:, :, node_class == j]
                total[node_class[i], j] += d.sum(axis=(0, 1, 2))
                square[node_class[i], j] += (d**2).sum(axis=(0, 1, 2))
                count[node_class[i], j] += d[..., 0].size
    count = np.maximum(count, 1)
    mean = total / count
    std = np.sqrt(np.maximum(square / count - mean**2, 0.0))
    return mean + origin[None, :] - origin[:, None], std


def node_classes(n_rigid: int, n_modes: int) -> np.ndarray:
    """int [V]: 0 for a rigid particle, 1 + k for mode k."""
    return np.concatenate([np.zeros(n_rigid, np.int32), 1 + np.arange(n_modes, dtype=np.int32)])
