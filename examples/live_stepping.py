"""Digs with the recommended model, frame by frame, and prints force, bound and status."""

import numpy as np

import learning_to_simulate as lts


def main(seconds: float = 1.5):
    """Moves the blade forward and down for some seconds; returns the last frame."""
    model = lts.load('excavation_v2/swept_field')
    live = model.stepper()
    pose, velocity = model.starts.pose[0].copy(), np.array([-0.05, -0.03, 0.0])
    live.start(pose, velocity)
    for k in range(round(seconds / live.dt)):
        pose[:3] += velocity * live.dt
        frame = live.step(pose)
        if k % 15 == 0:
            force = np.round(frame.force, 1)
            print(f'{k * live.dt:5.2f} s  force {force} +- {frame.bound:.0f} N  {frame.status}')
    heights = frame.height_map(40, 20)
    print(f'surface between {np.nanmin(heights):.3f} and {np.nanmax(heights):.3f} m')
    return frame


if __name__ == '__main__':
    main()
