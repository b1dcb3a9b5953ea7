"""Small synthetic raw runs in the format of the solver, and the datasets made of them."""

import json
import os

import numpy as np

from pca_tools import files

BOUNDS = [[0.1, 0.9], [0.2, 1.0], [0.1, 0.9]]
CONTEXT_NAMES = ['gravity', 'friction_angle_deg', 'load']


def scene(name):
    """Returns the scene dictionary of one of the two scenes."""
    wheel = name == 'wheel'
    ring = [[a, (a + turn) % 8] for a in range(8) for turn in (1, 7)]
    return {
        'name': name,
        'rigid_motion': 'driven' if wheel else 'prescribed',
        'rigid_edges': ring + [[a + 8, b + 8] for a, b in ring] if wheel else [],
        'context_names': CONTEXT_NAMES if wheel else [],
        'force': True,
        'up_axis': 1,
    }


def initial_soil():
    """Returns a block of 7 x 4 x 5 particles, slightly disturbed, [140, 3] m."""
    axes = (np.linspace(0.2, 0.8, 7), np.linspace(0.22, 0.4, 4), np.linspace(0.3, 0.7, 5))
    grid = np.stack(np.meshgrid(*axes, indexing='ij'), -1).reshape(-1, 3)
    return grid + np.random.default_rng(7).uniform(-0.01, 0.01, grid.shape)


def make_run(name, case, frames=24):
    """Returns the arrays of one run: a body that pushes a smooth mound of soil before it."""
    rng = np.random.default_rng(case)
    speed, depth = rng.uniform(0.004, 0.012), rng.uniform(0.02, 0.08)
    travel = speed * np.arange(frames)
    soil = initial_soil()
    front = 0.25 + travel
    reach = np.exp(-(((soil[None, :, 0] - front[:, None]) / 0.15) ** 2))
    surface = np.exp((soil[:, 1] - 0.4) / depth)
    moved = np.maximum.accumulate(reach * surface, axis=0) * travel[:, None]
    positions = soil + moved[..., None] * [0.6, 0.3, 0.0]
    positions[..., 2] += 0.2 * moved * (soil[:, 2] - 0.5)
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (frames, 1))
    if name == 'wheel':
        turn = 0.03 * np.arange(frames)[:, None] + np.pi / 4 * np.arange(8)
        ring = np.stack([0.15 * np.cos(turn), 0.15 * np.sin(turn), np.zeros_like(turn)], -1)
        body = np.concatenate([ring + [0, 0, 0.44], ring + [0, 0, 0.56]], axis=1)
        body += np.stack([front, 0.55 - 0.1 * travel, np.zeros(frames)], -1)[:, None]
        half = 0.015 * np.arange(frames)
        pose[:, :3] = np.stack([front, 0.55 - 0.1 * travel, np.full(frames, 0.5)], -1)
        pose[:, 3], pose[:, 6] = np.cos(half), np.sin(half)
    else:
        side, up = np.meshgrid(np.linspace(0.35, 0.65, 4), np.linspace(0.3, 0.7, 5), indexing='ij')
        face = np.stack([np.zeros(20), up.ravel(), side.ravel()], -1)
        body = face + np.stack([front, -depth * np.ones(frames), np.zeros(frames)], -1)[:, None]
        pose[:, 0], pose[:, 1] = front, -depth
    force = np.stack([50 + 900 * travel, 20 + 300 * travel, rng.normal(0, 0.5, frames)], -1)
    context = {'gravity': 9.81, 'friction_angle_deg': 30.0 + case, 'load': 100.0 + 7 * case}
    parameters = {
        'case': case,
        'seed': case,
        'context': context if name == 'wheel' else {},
        'speed_m_per_frame': speed,
    }
    return {
        'positions': positions.astype(np.float32),
        'rigid_positions': body.astype(np.float32),
        'force': force.astype(np.float32),
        'pose': pose.astype(np.float32),
        'parameters': np.array(json.dumps(parameters)),
    }


def write_raw_folder(folder, name, cases, frames=24, change=None, **parameters):
    """Writes a raw folder, made if absent, of the cases of a scene; returns its path.

    `change` is called with (case, arrays) and may alter the arrays before they are written.
    `parameters` are further ones of the runs, each a value or a function of the case; None is left
    out."""
    folder = str(folder)
    os.makedirs(folder, exist_ok=True)
    entries = []
    for case in cases:
        arrays = make_run(name, case, frames)
        held = json.loads(str(arrays['parameters']))
        more = {key: v(case) if callable(v) else v for key, v in parameters.items()}
        held |= {key: value for key, value in more.items() if value is not None}
        arrays['parameters'] = np.array(json.dumps(held))
        if change:
            change(case, arrays)
        path = os.path.join(folder, f'run_{case:03d}.npz')
        np.savez(path, **arrays)
        entry = {'file': os.path.basename(path), 'case': case, **files.fingerprint(path)}
        entries.append(entry | {'parameters': json.loads(str(arrays['parameters']))})
    manifest = {'scene': scene(name), 'dt': 1 / 60, 'bounds': BOUNDS, 'runs': entries}
    with open(os.path.join(folder, 'manifest.json'), 'w', encoding='utf-8') as file:
        json.dump(manifest, file)
    return folder


def raw_of(folder, case):
    """The arrays of a run in a raw folder."""
    return np.load(f'{folder}/run_{case:03d}.npz')
