"""GIF and MP4 files from frames of pixels, without a system ffmpeg.

A file appears whole or not at all.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import imageio_ffmpeg
import numpy as np
from PIL import Image
from scipy import spatial

from pca_tools import files

# Colours of the palette, and how many of them are exact. Fewer than 256 leave room for the
# transparent one that stands for "as in the frame before".
_GIF_COLORS, _GIF_EXACT = 200, 64
_UNKNOWN = 255
# GIF counts hundredths of a second, and viewers slow down whatever is shorter than two of them.
_GIF_TICK_MS, _GIF_LEAST_MS = 10, 20
_GIF_LAST_MS = 1500
# Of x264: 18 is visually lossless, 23 is its default.
_MP4_RATE_FACTOR = 20


def write_gif(
    path: str,
    frames: Iterable[np.ndarray],
    frame_seconds: float,
    samples: Sequence[np.ndarray],
) -> None:
    """Writes a GIF with one palette for all frames, so that what stands still costs nothing.

    Args:
        path: the file.
        frames: uint8 [height, width, 3] each.
        frame_seconds: time that a frame is shown; the last one stays for 1.5 s.
        samples: some of the frames, spread over the movie, to take the palette from.

    Raises:
        OSError: the file cannot be written.
    """
    palette = _Palette(samples)
    first, *rest = map(palette.image, frames)
    frame_ms = max(_GIF_TICK_MS * round(1e3 * frame_seconds / _GIF_TICK_MS), _GIF_LEAST_MS)
    durations = [frame_ms] * len(rest) + [_GIF_LAST_MS]

    def write(temporary: str) -> None:
        first.save(
            temporary, format='GIF', save_all=True, append_images=rest, duration=durations,
            loop=0, optimize=True,
        )  # fmt: skip

    files.write_atomically(path, write)


def write_mp4(path: str, frames: Iterable[np.ndarray], frame_seconds: float) -> None:
    """Writes an H.264 movie, through the ffmpeg that imageio-ffmpeg brings along.

    Args:
        path: the file.
        frames: uint8 [height, width, 3] each, both sizes even.
        frame_seconds: time that a frame is shown.

    Raises:
        OSError: ffmpeg fails, or the file cannot be written.
    """

    frames = iter(frames)
    first = next(frames)
    height, width = first.shape[:2]

    def write(temporary: str) -> None:
        # The temporary name has no ending that would tell ffmpeg the container.
        options = ['-f', 'mp4', '-crf', str(_MP4_RATE_FACTOR), '-movflags', '+faststart']
        writer = imageio_ffmpeg.write_frames(
            temporary, (width, height), fps=1.0 / frame_seconds, codec='libx264', quality=None,
            macro_block_size=2, output_params=options, ffmpeg_log_level='error',
        )  # fmt: skip
        writer.send(None)  # starts ffmpeg
        try:
            for pixels in itertools.chain([first], frames):
                writer.send(np.ascontiguousarray(pixels))
        finally:
            writer.close()

    files.write_atomically(path, write)


class _Palette:
    """One palette for all frames: the commonest colours exactly, the others by median cut.

    Pillow maps colours to a palette only roughly, which leaves a white page not quite white.
    """

    def __init__(self, samples: Sequence[np.ndarray]):
        values, counts = np.unique(
            np.concatenate([_packed(pixels).ravel() for pixels in samples]), return_counts=True
        )
        colors = _unpacked(values[np.argsort(-counts, kind='stable')])
        # Each colour once: a rare one, such as that of the fastest soil, counts like any other.
        rest = Image.fromarray(colors[None, min(_GIF_EXACT, len(colors) - 1) :])
        cut = rest.quantize(colors=_GIF_COLORS - _GIF_EXACT, method=Image.Quantize.MEDIANCUT)
        self._flat = colors[:_GIF_EXACT].tobytes() + bytes(cut.getpalette())
        self._tree = spatial.cKDTree(np.frombuffer(self._flat, np.uint8).reshape(-1, 3))
        # Index of each of the 2^24 colours, found when a colour is first met.
        self._table = np.full(1 << 24, _UNKNOWN, np.uint8)

    def image(self, pixels: np.ndarray) -> Image.Image:
        """The frame [height, width, 3] in colours of the palette."""
        packed = _packed(pixels)
        indices = self._table[packed]
        new = np.unique(packed[indices == _UNKNOWN])
        if len(new):
            self._table[new] = self._tree.query(_unpacked(new))[1]
            indices = self._table[packed]
        image = Image.fromarray(indices)
        image.putpalette(self._flat)
        return image


def _packed(pixels: np.ndarray) -> np.ndarray:
    """uint32 [...] of uint8 [..., 3]."""
    red, green, blue = np.moveaxis(pixels.astype(np.uint32), -1, 0)
    return red << 16 | green << 8 | blue


def _unpacked(values: np.ndarray) -> np.ndarray:
    """uint8 [..., 3] of uint32 [...]."""
    return np.stack([values >> 16, values >> 8 & 255, values & 255], axis=-1).astype(np.uint8)
