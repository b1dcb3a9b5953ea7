"""Ten trenches side by side, each with its heap, in one rollout; a film or a picture of it."""

import sys

import numpy as np

import learning_to_simulate as lts

# Of one trench: seconds, x and height of the edge, m: down, on, back off, out, over to the next.
TRENCH = ((0.0, 1.30, 0.36), (0.4, 1.30, 0.275), (1.2, 1.18, 0.239), (2.3, 0.84, 0.239),
          (1.2, 0.98, 0.239), (0.5, 1.02, 0.36), (0.8, 1.30, 0.36))  # fmt: skip
APART, COUNT = 0.45, 10


def path() -> np.ndarray:
    """[T, 7] poses, 60 a second."""
    first = 0.5
    seconds, x, y = np.array(TRENCH * COUNT).T
    z = first + APART * np.repeat(np.arange(COUNT), len(TRENCH))
    # Over to the next in the last piece of each.
    z[len(TRENCH) - 1 :: len(TRENCH)] += APART
    z[-1] = z[-2]
    times = np.cumsum(seconds)
    at = np.arange(0.0, times[-1], 1 / 60)
    position = np.stack([np.interp(at, times, v) for v in (x, y, z)], axis=1)
    lean = np.radians(15.0)  # its top leans back
    turn = np.tile([np.cos(lean / 2), 0.0, 0.0, -np.sin(lean / 2)], (len(at), 1))
    return np.concatenate([position, turn], axis=1)


def main(file: str = 'trenches.png', apart: str = '40'):
    """Writes a picture (png) or film (gif, mp4: so many frames apart); returns the rollout."""
    ground = lts.Terrain.flat((1.9, 2 * 0.5 + APART * (COUNT - 1)), height=0.25)
    rollout = lts.load('excavation').rollout(path(), ground, lts.Blade(width=0.4))
    change = rollout.heights[-1].astype(float) - rollout.heights[0]
    cell = 1e3 * ground.cell.prod()
    cut, heap = -change[change < 0].sum() * cell, change[change > 0].sum() * cell
    print(f'{rollout.status} {rollout.reason}; {cut:.1f} l cut, {heap:.1f} l in heaps')
    print(f'{len(rollout) / 60:.0f} s of motion in {rollout.seconds:.1f} s')
    rollout.render(file, step_stride=int(apart))
    return rollout


if __name__ == '__main__':
    main(*sys.argv[1:])
