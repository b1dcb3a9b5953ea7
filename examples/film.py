"""Draws films of machines on soil with MuJoCo's renderer, in a process of its own: TensorFlow and
Mesa's OpenGL in software cannot live in one."""

import os
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

FPS, SIZE = 15, (640, 360)


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
            self._frames.append((self._data.qpos.copy(), heights))

    def write(self) -> None:
        """Writes the film; says so where this machine cannot draw."""
        if not self._path:
            return
        import mujoco

        with tempfile.TemporaryDirectory() as folder:
            mujoco.mj_saveModel(self._model, os.path.join(folder, 'model.mjb'))
            qpos, heights = map(np.stack, zip(*self._frames, strict=True))
            np.savez(os.path.join(folder, 'frames.npz'), qpos=qpos, heights=heights)
            done = subprocess.run(
                [sys.executable, __file__, folder, os.path.abspath(self._path)],
                env={'MUJOCO_GL': 'egl'} | os.environ, capture_output=True, text=True,
            )  # fmt: skip
        if done.returncode:
            print(f'no film: {done.stderr.strip().splitlines()[-1:]}', file=sys.stderr)


def draw(folder: str, path: str) -> None:
    """Draws what a `Film` has saved."""
    import imageio_ffmpeg
    import mujoco
    from PIL import Image

    model = mujoco.MjModel.from_binary_path(os.path.join(folder, 'model.mjb'))
    data, frames = mujoco.MjData(model), np.load(os.path.join(folder, 'frames.npz'))
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:

        def drawn(qpos, heights):
            data.qpos[:], model.hfield_data[:] = qpos, heights
            mujoco.mj_forward(model, data)
            mujoco.mjr_uploadHField(model, renderer._mjr_context, 0)
            renderer.update_scene(data, camera='film')
            return renderer.render()

        if path.endswith('.png'):
            picture = Image.fromarray(drawn(frames['qpos'][-1], frames['heights'][-1]))
            picture.save(path, optimize=True)
            return
        partial = str(pathlib.Path(path).with_suffix('.part.mp4'))
        writer = imageio_ffmpeg.write_frames(partial, SIZE, fps=FPS, quality=6, macro_block_size=8)
        writer.send(None)
        for qpos, heights in zip(frames['qpos'], frames['heights'], strict=True):
            writer.send(drawn(qpos, heights))
        writer.close()
        os.replace(partial, path)


if __name__ == '__main__':
    draw(*sys.argv[1:])
