"""Small datasets whose soil follows the body by a known law, for tests of the simulator."""

import os

import numpy as np

from pca_tools import compression, dataset, files, particles, subspace

N_MODES, N_FRAMES, N_SOIL = 3, 40, 50
RADIUS = 0.1


def _body(rng, n_rigid, motion):
    """Positions [T, R, 3] of a rigid body: a plate that travels, or a ring that rolls and sinks."""
    t = np.arange(N_FRAMES)[:, None, None]
    if motion == 'prescribed':
        rows = np.arange(n_rigid)[:, None] * np.array([0.0, 0.03, 0.01])
        speed = rng.uniform(0.5e-3, 2e-3)
        # Unsteady, so that constant velocity is a poor prediction.
        travel = speed * (t + 12.0 * (1.0 - np.cos(t / 8.0)))
        return rows + np.array([0.8, 0.3, 0.2]) - travel * np.array([1.0, 0.3, 0.0])
    angle = 2 * np.pi * np.arange(n_rigid) / n_rigid + t[..., 0] * rng.uniform(0.005, 0.02)
    ring = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    ring[..., 2] += 0.01 * (np.arange(n_rigid) % 2)
    sinkage = 1e-2 * (1 - np.exp(-t * rng.uniform(0.01, 0.05)))
    return (
        ring
        + np.array([0.2, 0.3, 0.2])
        + t * 1e-3 * np.array([1.0, 0.0, 0.0])
        - sinkage * [0, 1, 0]
    )


def make_trajectory(seed, n_rigid=4, motion='prescribed', context=False, force=True):
    """One run: modes move in proportion to the body, the force follows its depth and speed;
    a `context` of True is constant, one of 'changing' is not."""
    rng = np.random.default_rng(seed)
    body = _body(rng, n_rigid, motion)
    step = np.diff(body.mean(axis=1), axis=0, prepend=body[:1].mean(axis=1))
    gain = np.array([[3.0, 0.5, 0.0], [-1.0, 0.2, 0.1], [0.1, 2.0, 0.0]])
    modes = np.array([9.0, -4.0, 0.5])[None, :, None] + np.cumsum(step[:, None] * gain, axis=0)
    depth = body[:1, :, 1].mean() - body[:, :, 1].mean(axis=1)
    forces = np.stack([100 * (depth + 0.01) * 50, 40 * depth, 0 * depth], axis=-1)
    forces += rng.normal(0, 0.1, forces.shape)
    types = np.array([3 if motion == 'prescribed' else 0] * n_rigid + [6] * N_MODES)
    values = None
    if context:
        values = np.tile([9.81, 30.0 + seed], (N_FRAMES, 1)).astype(np.float32)
    if context == 'changing':
        values[:, 1] += 5 * np.sin(np.arange(N_FRAMES) / 4 + seed)
    return dataset.Trajectory(
        key=seed,
        particle_type=types,
        position=np.concatenate([body, modes], axis=1).astype(np.float32),
        force=forces.astype(np.float32) if force else None,
        step_context=values,
    )


def write_dataset(
    folder, rigid_counts=(4,), motion='prescribed', context=False, force=True, n_run=4
):
    """Writes train, valid and test splits with metadata; returns the folder as a string.

    `rigid_counts` are taken in turn, so that a folder can hold two sizes of the body.
    """
    os.makedirs(folder, exist_ok=True)
    runs = {}
    for offset, (split, count) in enumerate((('train', n_run), ('valid', 2), ('test', 2))):
        runs[split] = [
            make_trajectory(
                100 * offset + i, rigid_counts[i % len(rigid_counts)], motion, context, force
            )
            for i in range(count)
        ]
        dataset.write_split(dataset.split_path(str(folder), split), runs[split])
    metadata = {
        'bounds': [[0.0, 1.0]] * 3,
        'sequence_length': N_FRAMES - 1,
        'default_connectivity_radius': 0.025,
        'dim': 3,
        'dt': 1 / 60,
        'mode_number': N_MODES,
        'n_soil': N_SOIL,
        'particles_rigid': rigid_counts[0],
        'scene': {
            'name': 'synthetic',
            'rigid_motion': motion,
            'rigid_edges': [[0, 1], [1, 0]] if motion == 'predicted' else [],
            'context_names': ['gravity', 'friction_angle_deg'] if context else [],
            'force': force,
            'up_axis': 1,
        },
    }
    modes = [run.position[:, run.n_rigid :] for run in runs['train']]
    for name, parts in (
        ('vel', [np.diff(x, axis=0) for x in modes]),
        ('acc', [np.diff(x, n=2, axis=0) for x in modes]),
        ('rigid_body_force', [run.force for run in runs['train']]),
        ('context', [run.step_context for run in runs['train']]),
    ):
        if parts[0] is not None:
            values = np.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])
            metadata[f'{name}_mean'] = values.mean(0).tolist()
            metadata[f'{name}_std'] = values.std(0).tolist()
    files.write_json(os.path.join(folder, 'metadata.json'), metadata)
    return str(folder)


def write_subspace(folder):
    """Writes a `subspace.npz` of the dataset's size: orthonormal modes without a meaning."""
    rng = np.random.default_rng(0)
    modes, _ = np.linalg.qr(rng.normal(size=(N_SOIL, N_MODES)))
    mean = rng.uniform(0, 1, (N_SOIL, 3))
    values = np.array([3.0, 2.0, 1.0])
    space = subspace.Subspace(mean, modes, values, 14.0, 360, 'configuration', ('a',), mean)
    space.save(os.path.join(folder, 'subspace.npz'))


def soil_of(folder, split, record, size=2e-3):
    """Particles [T, N, 3] of a run: its modes, and `size` (m) that no mode holds."""
    run, space = dataset.read_split(folder, split)[record], subspace.Subspace.load(
        os.path.join(folder, 'subspace.npz')
    )  # fmt: skip
    decoded = space.decode(run.position[:, run.n_rigid :].astype(np.float64))
    rest, w = np.random.default_rng(record).normal(size=decoded.shape), space.components
    return decoded + size * (rest - w @ (w.T @ rest))  # orthogonal to the modes, axis by axis


def write_particles(folder, stride=4):
    """Writes the particle samples of valid and test, of `soil_of`; returns the chosen particles."""
    chosen = np.arange(0, N_SOIL, 3)
    for split in ('valid', 'test'):
        count = len(dataset.read_split(folder, split))
        soil = [soil_of(folder, split, i)[::stride, chosen] for i in range(count)]
        write_sample(folder, split, soil, chosen, stride)
    return chosen


def write_sample(folder, split, soil, chosen, stride):
    """Writes the particle sample of a split: every `stride`-th frame of each run [T', P, 3], and
    which particles these are."""
    rest = soil[0][0]
    packed = [(compression.pack_steps(run, rest, 1e-7), len(run)) for run in soil]
    indices = np.asarray(chosen, np.int32)
    particles.ParticleSample.write(folder, split, packed, rest, stride, 1e-7, indices=indices)
