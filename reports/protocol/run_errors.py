"""The errors of one prediction of one run."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H

HORIZONS = (0.25, 0.5, 1.0, 2.0)  # s


@dataclasses.dataclass(frozen=True)
class RunPrediction:
    """What a method says of frames H .. T - 1 of one run; None where it says nothing.

    Attributes:
      modes: float64 [T - H, r, 3] scores, m; the soil, where `particles` is None.
      particles: function of frame numbers [F] and particle indices [P] -> [F, P, 3], m.
      force: [T - H, 3], N.
      height: [T - H] of the body's mean particle, m.
      torque: [T - H, 3], N m.
      status: of the rollout, or None.
    """

    modes: np.ndarray | None = None
    particles: Callable | None = None
    force: np.ndarray | None = None
    height: np.ndarray | None = None
    torque: np.ndarray | None = None
    status: str | None = None


def soil_errors(particles, truth) -> dict:
    """Errors of predicted soil.

    Args:
      particles: [F, P, 3] in the frames of the truth, m.
      truth: `truth.Truth`.

    Returns:
      `soil_mm`: root mean square over frames, particles and axes, in full space: what decoded truth
      lacks is added. `horizons_mm`: {seconds: root mean square in the frame next to it}, 'end' the
      last; `seconds_to_spacing`: when it first exceeds the spacing of the particles, None if
      never. Horizons of decoded truth are within the modes.
    """
    if particles.shape != truth.particles.shape:
        raise ValueError(
            f'predicted particles {particles.shape} do not fit the truth {truth.particles.shape}'
        )
    square = ((particles - truth.particles) ** 2).mean(axis=(1, 2))
    rms = 1e3 * np.sqrt(square)
    times = truth.times
    horizons = {
        f'{horizon:g}': float(rms[np.argmin(np.abs(times - horizon))])
        for horizon in HORIZONS
        if horizon <= times[-1]
    }
    horizons['end'] = float(rms[-1])
    # A NaN is beyond any spacing.
    beyond = ~(rms <= 1e3 * truth.spacing)
    return {
        'soil_mm': float(1e3 * np.sqrt(square.mean() + truth.cut_off)),
        'horizons_mm': horizons,
        'seconds_to_spacing': float(times[beyond.argmax()]) if beyond.any() else None,
    }


def relative_l2(predicted, truth) -> float:
    """|predicted - truth| / |truth| over all frames and axes."""
    return float(np.linalg.norm(predicted - truth) / np.linalg.norm(truth))


def run_errors(prediction: RunPrediction, truth, reader, indices) -> dict:
    """All errors of one run; quantities that the method or the data lack are absent.

    Args:
      prediction: of the method.
      truth: of the run.
      reader: `truth.TruthReader`, for decoding.
      indices: int [P] of the truth's particles.

    Returns:
      as `soil_errors`, and `modes_mm` (root mean square within the modes), `force_l2`, `force_n`
      (root mean square per component, N), `torque_l2`, `pitch_l2` (of the torque about
      the axis across the body's way), `height_mm`, `status`.
    """
    errors: dict[str, Any] = {}
    if prediction.particles is not None:
        errors |= soil_errors(prediction.particles(truth.frames, indices), truth)
    elif prediction.modes is not None:
        modes = prediction.modes[truth.frames - H]
        errors |= soil_errors(reader.decode(modes, indices), truth)
        r = prediction.modes.shape[1]
        square = ((prediction.modes - truth.modes[:, :r]) ** 2).sum(axis=(1, 2)).mean()
        left = (truth.modes[:, r:] ** 2).sum(axis=(1, 2)).mean() if r < truth.modes.shape[1] else 0
        n_soil = reader.subspace.n_soil
        errors['modes_mm'] = float(1e3 * np.sqrt((square + left) / (3 * n_soil)))
    if prediction.force is not None and truth.force is not None:
        errors['force_l2'] = relative_l2(prediction.force, truth.force)
        errors['force_n'] = float(np.sqrt(((prediction.force - truth.force) ** 2).mean()))
    if prediction.torque is not None and truth.torque is not None:
        errors['torque_l2'] = relative_l2(prediction.torque, truth.torque)
        pitch = (torque[:, truth.across] for torque in (prediction.torque, truth.torque))
        errors['pitch_l2'] = relative_l2(*pitch)
    if prediction.height is not None and truth.height is not None:
        errors['height_mm'] = float(1e3 * np.sqrt(((prediction.height - truth.height) ** 2).mean()))
    if prediction.status is not None:
        errors['status'] = prediction.status
    return errors
