"""Files of pictures: a PNG of a figure; GIF and MP4 from frames of pixels, by the ffmpeg that
imageio-ffmpeg brings along. A file appears whole or not at all."""

import functools
from collections.abc import Iterable

import imageio_ffmpeg
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pca_tools import files

# GIF counts hundredths of a second, and viewers slow down whatever is shorter than two of them.
_GIF_LEAST_SECONDS = 0.02
_OPTIONS = {
    # One palette for all frames, so that what stands still costs nothing; the last frame stays.
    'gif': (
        '-filter_complex', '[0]split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=none',
        '-final_delay', '150', '-loop', '0',
    ),
    # Of x264: a rate factor of 18 is visually lossless, 23 is its default.
    'mp4': ('-crf', '20', '-movflags', '+faststart'),
}  # fmt: skip


def write_png(path: str, figure: Figure) -> None:
    """Writes a figure as PNG; OSError where the file cannot be written."""
    files.write_atomically(path, functools.partial(figure.savefig, format='png'))


def pixels_of(canvas: FigureCanvasAgg) -> np.ndarray:
    """What is drawn on a canvas, uint8 [height, width, 3], both sizes even."""
    pixels = np.asarray(canvas.buffer_rgba())
    height, width = (2 * (size // 2) for size in pixels.shape[:2])
    return pixels[:height, :width, :3].copy()


def write(path: str, kind: str, frames: Iterable[np.ndarray], frame_seconds: float) -> None:
    """Writes a GIF or MP4 of frames uint8 [height, width, 3], both sizes even, that are shown for
    some seconds each. Until a GIF has its palette ffmpeg holds all frames, 2 MB each. OSError:
    ffmpeg fails, or the file cannot be written."""
    frames = iter(frames)
    first = next(frames)
    seconds = max(frame_seconds, _GIF_LEAST_SECONDS) if kind == 'gif' else frame_seconds

    def fill(temporary: str) -> None:
        # The temporary name has no ending that would tell ffmpeg the container.
        writer = imageio_ffmpeg.write_frames(
            temporary, first.shape[1::-1], fps=1.0 / seconds, quality=None, macro_block_size=2,
            codec='gif' if kind == 'gif' else 'libx264',
            pix_fmt_out='pal8' if kind == 'gif' else 'yuv420p',
            output_params=['-f', kind, *_OPTIONS[kind]], ffmpeg_log_level='error',
        )  # fmt: skip
        writer.send(None)  # starts ffmpeg
        try:
            writer.send(np.ascontiguousarray(first))
            for pixels in frames:
                writer.send(np.ascontiguousarray(pixels))
        finally:
            writer.close()

    files.write_atomically(path, fill)
