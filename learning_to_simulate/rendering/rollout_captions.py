"""The errors of a rollout in words: one line for a frame, one for the whole."""

from __future__ import annotations

import numpy as np

from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH, RolloutFrames

_GAP = '      '


def status_line(frames: RolloutFrames, frame: int) -> str:
    """Time and errors so far, one line."""
    parts = [f't = {frames.time[frame]:5.2f} s']
    if frame < frames.first_predicted:
        return _GAP.join([*parts, 'input frames, nothing predicted yet'])
    if not frames.has_truth:
        return _GAP.join(parts)
    parts.append(f'{_error_name(frames)} {frames.soil_rms_mm[PREDICTION][frame]:.2f} mm')
    if frames.body_is_predicted:
        parts.append(f'body error {frames.rigid_rms_mm[frame]:.2f} mm')
    if frames.force is not None:
        so_far = slice(frames.first_predicted, frame + 1)
        truth, predicted = (frames.force[which][so_far] for which in (TRUTH, PREDICTION))
        size = np.linalg.norm(truth)
        if size > 0:
            share = 100.0 * np.linalg.norm(predicted - truth) / size
            parts.append(f'force error so far {share:.0f} %')
    return _GAP.join(parts)


def summary_line(frames: RolloutFrames) -> str:
    """Errors of the whole rollout, one line."""
    if not frames.has_truth:
        return f'{frames.n_frames - frames.first_predicted} predicted frames'
    errors = frames.errors
    parts = [f'{_error_name(frames)} over all frames {errors["soil_rms_mm"]:.2f} mm']
    if frames.body_is_predicted:
        parts.append(f'body error {1e3 * errors["rigid_mse"] ** 0.5:.2f} mm')
    if 'force_relative_l2' in errors:
        parts.append(f'force error {100 * errors["force_relative_l2"]:.0f} %')
    return _GAP.join(parts)


def _error_name(frames: RolloutFrames) -> str:
    return 'mode score error (RMS)' if frames.n_soil is None else 'soil error (RMS)'
