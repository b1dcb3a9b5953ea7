"""`Scene`: what exists in a simulation, read from `metadata.json`.

Everything that the model may leave out follows from the scene: a part that is absent costs no
variable, no operation and no edge. Nothing in the package asks for the name of a scene.
"""

import dataclasses
import enum
import math

# No body of the project has more than 20 particles; a damaged number must not ask for the memory
# of a graph of millions.
MAX_RIGID, MAX_MODES = 1000, 10_000


class RigidMotion(enum.StrEnum):
    """How the rigid body moves in a rollout.

    PRESCRIBED: the pose of every frame is given (a blade on its path).
    DRIVEN: rotation and travel are given, the height is predicted (a wheel under load).
    PREDICTED: every rigid particle is predicted, then corrected to a rigid motion (the published
      wheel).
    NONE: there is no rigid body.
    """

    NONE = 'none'
    PRESCRIBED = 'prescribed'
    DRIVEN = 'driven'
    PREDICTED = 'predicted'

    @property
    def is_known(self) -> bool:
        """Whether the coming frame of the body is (at least in part) given to the model."""
        return self in (RigidMotion.PRESCRIBED, RigidMotion.DRIVEN)


@dataclasses.dataclass(frozen=True)
class Scene:
    """Static description of a scene; SI units. ValueError for a name that cannot be printed, which
    XML and C could not hold either.

    Attributes:
      name: label for pictures and tables; nothing branches on it.
      n_modes: r, the number of subspace modes (the last r nodes).
      rigid_motion: see `RigidMotion`.
      rigid_edges: directed geometry neighbours (sender, receiver) of the rigid particles, used
        where the rigid motion is predicted.
      has_force: whether the records hold the force on the body.
      context_names: names of the C global values, () if there are none.
      n_soil: N, the number of particles that the modes stand for, or None if unknown.
      dt: seconds per frame.
      up_axis: axis against gravity.
      connectivity_radius: length that scales edge features of the published presets, m.
      bodies: (name, number of nodes) of several bodies in the order of their nodes, all of given
        motion; () of one or none. Of each there is a force [D], one behind the other.
    """

    name: str
    n_modes: int
    rigid_motion: RigidMotion
    rigid_edges: tuple[tuple[int, int], ...]
    has_force: bool
    context_names: tuple[str, ...]
    n_soil: int | None
    dt: float
    up_axis: int = 1
    connectivity_radius: float = 0.025
    bodies: tuple[tuple[str, int], ...] = ()

    def __post_init__(self):
        names = (self.name, *self.context_names, *(name for name, _ in self.bodies))
        if bad := [name for name in names if not str(name).isprintable()]:
            raise ValueError(f'names of a scene are printable text, got {bad[0]!r}')

    @classmethod
    def from_metadata(cls, metadata, *, rigid_particle_type=None, rigid_motion=None) -> 'Scene':
        """Reads a scene from metadata of `pca_tools.dataset.read_metadata`.

        `rigid_particle_type`, of the first node of the records, decides the rigid motion of folders
        that carry no scene (3, kinematic: prescribed; other: predicted). `rigid_motion` overrides
        the motion, e.g. 'driven' for the authors' wheel or 'predicted' for the published way.
        ValueError if it is unknown, or neither stated nor deducible.
        """
        stated = metadata.get('scene', {})
        motion = rigid_motion or stated.get('rigid_motion')
        if motion is None:
            if rigid_particle_type is None:
                raise ValueError(
                    "metadata.json has no 'scene' and no particle type was given: pass "
                    '--rigid_motion'
                )
            motion = 'prescribed' if rigid_particle_type == 3 else 'predicted'
        if motion not in list(RigidMotion):
            raise ValueError(
                f'rigid_motion is {motion!r}, must be one of {[str(m) for m in RigidMotion]}'
            )
        bodies = stated.get('bodies', ())
        free = [b['name'] for b in bodies if b['rigid_motion'] != RigidMotion.PRESCRIBED]
        if free or bodies and motion != RigidMotion.PRESCRIBED:
            raise ValueError(
                f'several bodies {[b["name"] for b in bodies]}, of which {free or "all"} move by '
                'themselves: only one body can be predicted. State the recorded motion as '
                'prescribed, or write runs in which that body is the only one'
            )
        n_context = len(metadata.get('context_mean', ()))
        names = stated.get('context_names') or [f'context_{i}' for i in range(n_context)]
        return cls(
            name=stated.get('name', 'unnamed'),
            n_modes=int(metadata['mode_number']),
            rigid_motion=RigidMotion(motion),
            rigid_edges=tuple((int(s), int(r)) for s, r in stated.get('rigid_edges', ())),
            has_force='rigid_body_force_mean' in metadata,
            context_names=tuple(names),
            n_soil=metadata.get('n_soil'),
            dt=float(metadata['dt']),
            up_axis=int(stated.get('up_axis', 1)),
            connectivity_radius=float(metadata['default_connectivity_radius']),
            bodies=tuple((str(b['name']), int(b['points'])) for b in bodies),
        )

    def check_one_body(self, what: str) -> None:
        """Raises ValueError for several bodies, which `what` does not know."""
        if self.bodies:
            raise ValueError(
                f'the scene has the bodies {[name for name, _ in self.bodies]}; {what} knows one. '
                'Networks on modes (pcg, mlp) learn on them, roll out recorded runs, and are '
                'exported as SavedModel or LiteRT'
            )

    def to_json(self) -> dict:
        return dataclasses.asdict(self) | {'rigid_motion': str(self.rigid_motion)}

    @classmethod
    def from_json(cls, values: dict) -> 'Scene':
        """Rebuilds a scene from `to_json`; KeyError, TypeError or ValueError where a field is
        missing, unknown or wrong."""
        scene = cls(
            **values
            | {
                'rigid_motion': RigidMotion(values['rigid_motion']),
                'rigid_edges': tuple(map(tuple, values['rigid_edges'])),
                'context_names': tuple(values['context_names']),
                'bodies': tuple(map(tuple, values.get('bodies', ()))),
            }
        )
        scene.check()
        return scene

    def check(self) -> None:
        """Raises ValueError where a field is of another type or outside its range."""
        radius = self.connectivity_radius
        require(isinstance(self.name, str), 'scene.name', self.name)
        require(is_int(self.n_modes, 1, MAX_MODES), 'scene.n_modes', self.n_modes)
        require(isinstance(self.rigid_motion, RigidMotion), 'rigid_motion', self.rigid_motion)
        require(isinstance(self.has_force, bool), 'scene.has_force', self.has_force)
        require(self.n_soil is None or is_int(self.n_soil, 1, 2**31), 'scene.n_soil', self.n_soil)
        require(_is_positive(self.dt), 'scene.dt', self.dt)
        require(is_int(self.up_axis, 0, 2), 'scene.up_axis', self.up_axis)
        require(_is_positive(radius), 'scene.connectivity_radius', radius)
        require(all(isinstance(n, str) for n in self.context_names), 'context_names', '...')
        for name, count in self.bodies:
            require(isinstance(name, str) and is_int(count, 1, MAX_RIGID), 'body', (name, count))
        for edge in self.rigid_edges:
            require(len(edge) == 2 and all(is_int(e, 0, MAX_RIGID) for e in edge), 'edge', edge)


def require(condition, name: str, value) -> None:
    """Raises ValueError that says what the value of a name is, unless the condition holds."""
    if not condition:
        raise ValueError(f'{name} is {value!r}')


def is_int(value, low: int, high: int) -> bool:
    """Whether a value of a JSON file is a whole number in [low, high]."""
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _is_positive(value):
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and value > 0
