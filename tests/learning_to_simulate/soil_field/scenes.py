"""Poses, terrains and paths of small scenes, and what is done to a whole scene."""

import numpy as np
from scipy.spatial.transform import Rotation

from learning_to_simulate.soil_field.passage import Passage
from learning_to_simulate.soil_field.terrain import Terrain

DT = 1 / 60
# u, height over the ground (m) and lean (rad): in the air, down, along, up a bit, back, on.
PATH = np.array(
    [[0.0, 0.05, 0.0], [0.03, 0.01, 0.1], [0.08, -0.035, 0.2], [0.16, -0.05, 0.25],
     [0.27, -0.055, 0.2], [0.36, -0.03, 0.1], [0.33, -0.04, 0.15], [0.41, -0.06, 0.2],
     [0.47, -0.05, 0.2]]
)  # fmt: skip


def poses(path, yaw=0.0, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    """[T, 7] of u, y, lean [T, 3] of a tool that looks along -x, in a scene that is turned by a yaw
    about the origin and then moved by a shift."""
    path = np.asarray(path, float)
    turn = Rotation.from_euler('y', yaw)
    place = turn.apply(np.stack([-path[:, 0], path[:, 1], 0 * path[:, 0]], axis=1)) + shift
    lean = turn * Rotation.from_rotvec(path[:, 2:] * [0.0, 0.0, -1.0])
    return np.concatenate([place, lean.as_quat()[:, [3, 0, 1, 2]]], axis=1)


def mirrored(pose) -> np.ndarray:
    """Poses seen in a mirror at z = 0."""
    return np.asarray(pose) * [1, 1, -1, 1, -1, -1, 1]


def hills(cell=0.02, size=(1.6, 1.2), scale=1.0) -> Terrain:
    """Smooth and without symmetry, 0.8 m of it behind x = 0; its middle is at z = 0."""
    nx, nz = (int(round(s / cell)) for s in size)
    x, z = cell * (np.arange(nx) + 0.5) - 1.1, cell * (np.arange(nz) + 0.5) - size[1] / 2
    heights = 0.02 * np.sin(5 * x[:, None] + 1) * np.cos(4 * z) + 0.04 * np.exp(
        -((x[:, None] + 0.3) ** 2 + (z - 0.2) ** 2) / 0.02
    )
    corner = scale * np.array([-1.1, -size[1] / 2])
    return Terrain(scale * heights, scale * cell, corner)


def walk(terrain, tool, pose, dt=DT, **more) -> tuple[Passage, list]:
    """The passage at the end of poses [T, 7], and its frames."""
    passage = Passage(terrain, tool, pose[0], **more)
    frames = [passage.frame]
    for p in pose[1:]:
        passage.step(p, dt)
        frames.append(passage.frame)
    return passage, frames


def assert_frames(found, wanted, atol=1e-6):
    """Holds two lists of frames together."""
    for t, (f, w) in enumerate(zip(found, wanted, strict=True)):
        for name in ('bins', 'scalars'):
            a, b = getattr(f, name), getattr(w, name)
            np.testing.assert_allclose(a, b, atol=atol, rtol=1e-5, err_msg=f'{name} of frame {t}')
