"""Errors of modes, bodies and loads, and the trivial predictors. See also `soil_truth`."""

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH


def soil_mse(position, truth, n_rigid: int, n_soil: int):
    """Mean squared error of the N soil particles within the subspace, float64 [S], m²: sum of
    squared score errors / (D N), mean over frames (Haeri & Skonieczny 2021). Of positions [S, T, V,
    D], whose modes follow the first R nodes."""
    error = (position - truth)[:, :, n_rigid:]
    return (error**2).sum(axis=(2, 3)).mean(axis=1) / (truth.shape[-1] * n_soil)


def rigid_mse(position, truth, n_rigid: int):
    """Mean squared error of the rigid particles per run, m², [S] (mean over particles, axes and
    frames)."""
    error = (position - truth)[:, :, :n_rigid]
    return (error**2).mean(axis=(1, 2, 3))


def height_mm(position, truth, n_rigid: int, up: int):
    """Root mean square over frames of the error of the body's mean height, per run, mm, [S]."""
    error = (position - truth)[:, :, :n_rigid, up].mean(axis=2)
    return rms_mm((error**2).mean(axis=1))


def force_errors(force, truth, name: str = 'force', least: float = 0.0) -> dict[str, np.ndarray]:
    """Errors of a force [S, T, D] (N; a torque N m), or of one axis of it, per run.

    With `name` as the first word: `_relative_l2` = |F̂ - F| / |F| over all frames and axes, where
    |F| counts as at least that of a constant force `least`, N; `_rmse` in N per component;
    `_mpe` in percent: mean over frames of |F̂| against that of |F|, signed (Usmani & Skonieczny
    2023, Table 3.3); `_peak`, the largest |F| of the run, and `_peak_error`, how far that of the
    prediction is from it, N.
    """
    error = force - truth
    sizes = [np.linalg.norm(f, axis=-1) for f in (force, truth)]
    (size, true_size), (peak, true_peak) = (
        [f(s, axis=1) for s in sizes] for f in (np.mean, np.max)
    )
    with np.errstate(divide='ignore', invalid='ignore'):
        square = np.maximum((truth**2).sum(axis=2).mean(axis=1), least**2)
        share = (error**2).sum(axis=2).mean(axis=1) / square
        return {
            f'{name}_relative_l2': np.sqrt(share),
            f'{name}_rmse': np.sqrt((error**2).mean(axis=(1, 2))),
            f'{name}_mpe': 100.0 * (size - true_size) / true_size,
            f'{name}_peak': true_peak,
            f'{name}_peak_error': np.abs(peak - true_peak),
        }


def travel_axes(body, up: int) -> tuple[int, int, int]:
    """The horizontal axis along which the centre of a body [T, R, 3] moves most (the first one,
    where there is no body), the upward one, and the one across."""
    moved = np.ptp(body.mean(axis=1), axis=0) if body.shape[1] else np.zeros(3)
    along, across = sorted((a for a in range(3) if a != up), key=lambda axis: (-moved[axis], axis))
    return along, up, across


def load_errors(force, truth, axes, torque=None, true_torque=None) -> dict[str, np.ndarray]:
    """Errors of force [S, T, D B], N, on B bodies, and torque [S, T, D], N m, or None, as a whole
    and by axis of `travel_axes`, per run, as `force_errors`: of `force`; of `drawbar`, the force
    along the way; of `vertical`; of `torque`, and of `pitch`, the torque in the plane of travel."""
    along, up, across = axes
    found = force_errors(force, truth)
    for name, axis in (('drawbar', along), ('vertical', up)):
        found |= force_errors(force[..., axis::3], truth[..., axis::3], name)
    if torque is not None and true_torque is not None:
        found |= force_errors(torque, true_torque, 'torque')
        found |= force_errors(torque[..., [across]], true_torque[..., [across]], 'pitch')
    return found


def stay_still(history, n_frame: int):
    """Persistence: the last of the H input frames [S, H, V, D] for ever, [S, n_frame, V, D]."""
    return np.repeat(history[:, -1:], n_frame, axis=1)


def constant_velocity(history, n_frame: int):
    """Trivial predictor: the displacement of the last input frame goes on, [S, n_frame, V, D]."""
    step = history[:, -1:] - history[:, -2:-1]
    return history[:, -1:] + step * np.arange(1, n_frame + 1)[None, :, None, None]


def soil_mm(points, truth, stride: int) -> float:
    """Error of particles [F, P, 3] (m), of which every `stride` frames were kept, from the frame on
    from which errors count, mm per coordinate."""
    late = slice(-(-INPUT_SEQUENCE_LENGTH // stride), None)
    return float(rms_mm(np.mean((np.asarray(points, np.float64)[late] - truth[late]) ** 2)))


def rms_mm(mse):
    """Root of a mean squared error in m², in mm per coordinate."""
    return 1e3 * np.sqrt(mse)
