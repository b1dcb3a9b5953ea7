"""Rolls out a path of one's own and a recorded run, with their status, file and picture."""

import sys

import numpy as np

import learning_to_simulate as lts


def main(folder: str = '.'):
    """Writes `dig.npz` and `dig.png` into a folder; returns both rollouts."""
    model = lts.load('excavation')
    path = np.tile([2.0, 0.27, 1.0, 1.0, 0.0, 0.0, 0.0], (150, 1))
    path[:, :3] += np.arange(150)[:, None] * np.array([-0.05, -0.02, 0.0]) / 60
    rollout = model.rollout(path, lts.Terrain.flat((3.0, 2.0), height=0.25))
    print(f'own path: {rollout.status} {rollout.reason}, force at the end {rollout.force[-1]} N')
    rollout.save(f'{folder}/dig.npz')
    rollout.render(f'{folder}/dig.png')
    recorded = model.rollout(lts.Dataset('excavation').test[0])
    print(f'recorded run: {recorded.status}, {len(recorded.force)} frames')
    return rollout, recorded


if __name__ == '__main__':
    main(*sys.argv[1:])
