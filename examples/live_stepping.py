"""Digs with the recommended model, frame by frame, and prints force, bound and status."""

import numpy as np

import learning_to_simulate as lts

DT = 1 / 60  # s


def main(seconds: float = 1.5):
    """Moves the blade forward and down for some seconds; returns the last frame."""
    ground = lts.Terrain.flat((3.0, 2.0), height=0.25)
    live = lts.load('excavation').stepper(ground, lts.Blade(width=0.4))
    pose, velocity = np.array([2.0, 0.27, 1.0, 1.0, 0.0, 0.0, 0.0]), np.array([-0.05, -0.03, 0.0])
    live.start(pose)
    for k in range(round(seconds / DT)):
        pose[:3] += velocity * DT
        frame = live.step(pose)
        if k % 15 == 0:
            force = np.round(frame.force, 1)
            print(f'{k * DT:5.2f} s  force {force} +- {frame.bound:.0f} N  {frame.status}')
    heights = ground.heights
    print(f'surface between {heights.min():.3f} and {heights.max():.3f} m')
    return frame


if __name__ == '__main__':
    main()
