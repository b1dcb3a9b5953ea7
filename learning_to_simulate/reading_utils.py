"""Records in memory: runs of one dataset split, grouped by their number of rigid particles.

Subspace records are small (about 100 kB a run), so a split is read once, and training windows are
gathered from it inside the compiled step: no input pipeline, no py_function, and which windows a
step sees is a function of (seed, step) alone.
"""

import dataclasses

import numpy as np

from learning_to_simulate import connectivity_utils
from learning_to_simulate.scene import RigidMotion, Scene
from pca_tools import dataset, legacy_pickles

_BY_RUN = 'position', 'force', 'context', 'record', 'body', 'kept', 'left_modes'


@dataclasses.dataclass(frozen=True)
class RunGroup:
    """S runs of graphs of the same size.

    Attributes:
      n_rigid: R, rigid particles that are nodes.
      particle_type: int64 [V].
      position: float64 [S, T, V, D], m.
      force: float64 [S, T, D], N, or [S, T, B D] of B bodies; or None.
      context: float64 [S, C], or [S, T, C] where that of a run changes in time, or None.
      record: int [S], index of each run in its file.
      body: per run, float64 [T, R', D]: all rigid particles of the record; None if all of them are
        nodes.
      kept: int [S, R]: which of the record's rigid particles are the nodes; None for all.
      left_modes: float64 [S, T, r', D], scores of the modes that are no nodes; None if all are.
      source: (dataset folder, split) of the records, or None.
    """

    n_rigid: int
    particle_type: np.ndarray
    position: np.ndarray
    force: np.ndarray | None
    context: np.ndarray | None
    record: np.ndarray
    body: tuple[np.ndarray, ...] | None = None
    kept: np.ndarray | None = None
    left_modes: np.ndarray | None = None
    source: tuple[str, str] | None = None

    @property
    def velocity(self) -> np.ndarray:
        """float64 [S, T, V, D], displacement since the frame before; 0 in frame 0."""
        return np.diff(self.position, axis=1, prepend=self.position[:, :1])

    @property
    def context_changes(self) -> bool:
        return self.context is not None and self.context.ndim == 3

    @property
    def context_by_frame(self) -> np.ndarray | None:
        """float64 [S, T, C]; None without a context."""
        if self.context is None or self.context_changes:
            return self.context
        shape = (*self.position.shape[:2], self.context.shape[-1])
        return np.broadcast_to(self.context[:, None], shape)

    def context_at(self, frame: int, run: int) -> np.ndarray | None:
        """float64 [C]: the context in a frame of a run; None without one."""
        return None if self.context is None else self.context_by_frame[run, frame]

    @property
    def n_left_modes(self) -> int:
        """r', the modes of the records that are no nodes."""
        return 0 if self.left_modes is None else self.left_modes.shape[2]

    def select(self, run: int) -> 'RunGroup':
        return self.take([run])

    def take(self, runs) -> 'RunGroup':
        """The group of some of its runs, in the given order; a run may come more than once."""
        parts = {}
        for name in _BY_RUN:
            values = getattr(self, name)
            if isinstance(values, tuple):
                parts[name] = tuple(values[i] for i in runs)
            elif values is not None:
                parts[name] = values[runs]
        return dataclasses.replace(self, **parts)

    def with_left_modes(self, position, as_recorded: bool = False) -> np.ndarray:
        """Puts the modes that are no nodes behind the nodes of predicted or true last T' frames
        [S, T', V, D]: as recorded, or as 0, which is what a prediction says of them."""
        if self.left_modes is None:
            return position
        left = self.left_modes[:, -position.shape[1] :]
        return np.concatenate([position, left if as_recorded else np.zeros_like(left)], axis=2)

    def all_particles(self, position, as_recorded: bool = False) -> list[np.ndarray]:
        """Puts the rigid particles and modes that are not nodes back, for writing; arguments as of
        `with_left_modes`. Returns per run [T', V', D] with all rigid particles and modes of the
        record; those of the body that are no nodes are as recorded, since its motion is given."""
        position = self.with_left_modes(position, as_recorded)
        if self.body is None:
            return list(position)
        whole = []
        for nodes, body, kept in zip(position, self.body, self.kept, strict=True):
            rigid = body[-len(nodes) :].copy()
            rigid[:, kept] = nodes[:, : self.n_rigid]
            whole.append(np.concatenate([rigid, nodes[:, self.n_rigid :]], axis=1))
        return whole

    def all_particle_types(self) -> np.ndarray:
        """int64 [V'] of one run of the group, with what is not a node."""
        n_extra = 0 if self.body is None else self.body[0].shape[1] - self.n_rigid
        first, last = self.particle_type[[0, -1]]
        left = np.full(self.n_left_modes, last)
        return np.concatenate([np.full(n_extra, first), self.particle_type, left])


def read_groups(
    folder: str, split: str, metadata: dict, rigid_particles: int = 0, modes: int = 0
) -> list[RunGroup]:
    """Reads a split as groups of equal R and T, sorted by R; of each body with prescribed motion at
    most `rigid_particles` become nodes, the lowest ones of the first frame, and of the modes the
    first `modes`; 0 keeps all. FileNotFoundError, ValueError: as `pca_tools.dataset.read_split`;
    more modes than there are."""
    if modes > metadata['mode_number']:
        raise ValueError(f'{folder}: has {metadata["mode_number"]} modes, not {modes}')
    up = metadata.get('scene', {}).get('up_axis', 1)
    points = [body['points'] for body in metadata.get('scene', {}).get('bodies', [])]
    ends = np.cumsum(points, dtype=int)[:-1]
    runs: dict[tuple, list] = {}
    for index, run in enumerate(dataset.read_split(folder, split)):
        is_given = run.particle_type[0] == dataset.KINEMATIC_PARTICLE_ID
        bodies = np.split(np.arange(run.n_rigid), ends)
        if rigid_particles and is_given:
            height = run.position[0, :, up]
            lowest = (body[np.argsort(height[body], kind='stable')] for body in bodies)
            bodies = [np.sort(body[:rigid_particles]) for body in lowest]
        kept = np.concatenate(bodies)
        runs.setdefault((len(kept), run.n_frames), []).append((index, run, kept))
    return [
        dataclasses.replace(_stack(n_rigid, members, modes), source=(folder, split))
        for (n_rigid, _), members in sorted(runs.items())
    ]


def _stack(n_rigid, members, modes):
    """One group of runs [(record, trajectory, kept rigid particles)], with the first modes."""
    record, runs, kept = zip(*members, strict=True)
    first = runs[0]
    nodes = [
        np.concatenate([k, np.arange(run.n_rigid, run.n_rigid + (modes or run.n_modes))])
        for run, k in zip(runs, kept, strict=True)
    ]

    def stacked(arrays):
        return np.stack(arrays).astype(np.float64)

    body = left_modes = None
    if any(run.n_rigid != n_rigid for run in runs):
        body = tuple(run.position[:, : run.n_rigid].astype(np.float64) for run in runs)
    if 0 < modes < first.n_modes:
        left_modes = stacked([run.position[:, run.n_rigid + modes :] for run in runs])
    return RunGroup(
        n_rigid=n_rigid,
        particle_type=first.particle_type[nodes[0]],
        position=stacked([run.position[:, n] for run, n in zip(runs, nodes, strict=True)]),
        force=force_of(runs),
        context=context_of(runs),
        record=np.array(record),
        body=body,
        kept=None if body is None else np.stack(kept),
        left_modes=left_modes,
    )


def force_of(runs) -> np.ndarray | None:
    """The force on the body in T-frame runs, N, float64 [S, T, D], or [S, T, B D] on B bodies where
    it is known of each."""
    if runs[0].force is None:
        return None
    forces = (run.force if run.body_force is None else run.body_force for run in runs)
    return np.stack([force.reshape(len(force), -1) for force in forces]).astype(np.float64)


def context_of(runs) -> np.ndarray | None:
    """The context of T-frame runs, float64: [S, C] where none changes in time, else [S, T, C]."""
    if runs[0].step_context is None:
        return None
    context = np.stack([run.step_context for run in runs]).astype(np.float64)
    return context if np.ptp(context, axis=1).any() else context[:, 0]


def read_scene(
    folder: str, metadata: dict, groups: list[RunGroup], rigid_motion: str | None
) -> Scene:
    """The scene of a dataset; what its metadata does not state is taken from the `groups` of any
    split, and `rigid_motion` overrides it. Raises ValueError as `Scene.from_metadata`."""
    first = groups[0]
    scene = Scene.from_metadata(
        metadata,
        rigid_particle_type=int(first.particle_type[0]) if first.n_rigid else None,
        rigid_motion=rigid_motion or ('none' if not first.n_rigid else None),
    )
    edges, bodies, n_soil = scene.rigid_edges, scene.bodies, scene.n_soil
    if scene.rigid_motion == RigidMotion.PREDICTED and not edges:
        edges = connectivity_utils.nearest_neighbour_edges(first.position[0, 0, : first.n_rigid])
    if bodies and first.kept is not None:
        names, counts = zip(*bodies, strict=True)
        of_body = np.searchsorted(np.cumsum(counts), first.kept[0], side='right')
        bodies = tuple(zip(names, np.bincount(of_body).tolist(), strict=True))
    if n_soil is None:
        n_soil = legacy_pickles.soil_particles(folder)
    if n_soil is None:
        raise ValueError(
            f'{folder}: metadata.json states no n_soil (soil particles N), without which errors '
            f'have no unit'
        )
    n_modes = first.position.shape[2] - first.n_rigid
    return dataclasses.replace(
        scene, n_modes=n_modes, rigid_edges=edges, bodies=bodies, n_soil=n_soil
    )
