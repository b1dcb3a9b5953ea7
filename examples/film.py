"""Draws films of machines on soil with MuJoCo's renderer, in a process of its own: TensorFlow and
Mesa's OpenGL in software cannot live in one."""

import os
import pathlib
import subprocess
import sys
import tempfile

import mujoco
import numpy as np

FPS, SIZE = 15, (640, 360)
SOIL = 0.62, 0.47, 0.32, 1.0
TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


class Film:
    """Frames of a machine and its soil.

    Args:
      path: of the film (.mp4), or of a picture of its end (.png); None: frames are dropped.
    """

    def __init__(self, path, model, data, soil):
        self._path, self._model, self._data, self._soil = path, model, data, soil
        self._frames = []

    def look(self) -> None:
        """Takes a frame where it is due."""
        if self._path and self._data.time >= len(self._frames) / FPS - 1e-9:
            self._soil.draw()
            heights = np.array(self._model.hfield_data, np.float32)
            lumps = [_lump(f.pose, f.payload) for f in self._soil.frames.values()]
            self._frames.append((self._data.qpos.copy(), heights, np.stack(lumps)))

    def write(self) -> None:
        """Writes the film; says so where this machine cannot draw."""
        if not self._path:
            return
        with tempfile.TemporaryDirectory() as folder:
            mujoco.mj_saveModel(self._model, os.path.join(folder, 'model.mjb'))
            names = 'qpos', 'heights', 'lumps'
            values = map(np.stack, zip(*self._frames, strict=True))
            np.savez(os.path.join(folder, 'frames.npz'), **dict(zip(names, values, strict=True)))
            done = subprocess.run(
                [sys.executable, __file__, folder, os.path.abspath(self._path)],
                env={'MUJOCO_GL': 'egl'} | os.environ, capture_output=True, text=True,
            )  # fmt: skip
        if done.returncode:
            print(f'no film: {done.stderr.strip().splitlines()[-1:]}', file=sys.stderr)


def _lump(pose, volume):
    """Place [3], half axes [3] and turn [9], z up, of an ellipsoid of soil in a bucket of 0.4 m
    width that curls back."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, pose[3:])
    along, across = turn.reshape(3, 3)[:, 0], turn.reshape(3, 3)[:, 2]
    level = np.array([along[0], 0.0, along[2]]) / np.hypot(along[0], along[2])
    centre = pose[:3] + turn.reshape(3, 3) @ [0.12, 0.05, 0.0]
    half, long = 0.19, 0.12
    high = volume / (4.0 / 3.0 * np.pi * half * long)
    axes = np.stack([level, across, np.cross(level, across)], axis=1)
    return np.concatenate(
        [TO_Z_UP @ centre, [long, half, high] if volume else np.zeros(3), (TO_Z_UP @ axes).ravel()]
    )


def draw(folder: str, path: str) -> None:
    """Draws what a `Film` has saved."""
    import imageio_ffmpeg
    from PIL import Image

    model = mujoco.MjModel.from_binary_path(os.path.join(folder, 'model.mjb'))
    data, frames = mujoco.MjData(model), np.load(os.path.join(folder, 'frames.npz'))
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:

        def drawn(qpos, heights, lumps):
            data.qpos[:], model.hfield_data[:] = qpos, heights
            mujoco.mj_forward(model, data)
            mujoco.mjr_uploadHField(model, renderer._mjr_context, 0)
            renderer.update_scene(data, camera='film')
            scene, shape = renderer.scene, mujoco.mjtGeom.mjGEOM_ELLIPSOID
            for place, size, turn in zip(lumps[:, :3], lumps[:, 3:6], lumps[:, 6:], strict=True):
                if size.all():
                    geom = scene.geoms[scene.ngeom]
                    mujoco.mjv_initGeom(geom, shape, size, place, turn, model.geom_rgba[0])
                    geom.rgba[:] = SOIL
                    scene.ngeom += 1
            return renderer.render()

        if path.endswith('.png'):
            picture = Image.fromarray(drawn(*(frames[n][-1] for n in ('qpos', 'heights', 'lumps'))))
            picture.save(path, optimize=True)
            return
        partial = str(pathlib.Path(path).with_suffix('.part.mp4'))
        writer = imageio_ffmpeg.write_frames(partial, SIZE, fps=FPS, quality=6, macro_block_size=8)
        writer.send(None)
        for frame in zip(frames['qpos'], frames['heights'], frames['lumps'], strict=True):
            writer.send(drawn(*frame))
        writer.close()
        os.replace(partial, path)


if __name__ == '__main__':
    draw(*sys.argv[1:])
