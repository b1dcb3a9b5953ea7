"""Every error that the reports print, with the trivial predictors and the truncation error.

The modes are orthonormal, so squared errors of particles are those of scores plus what the subspace
cut off, the truncation error: MSE_full = sum of squared score errors / (D N) + truncation error.
"""

import numpy as np


def soil_mse(position, truth, n_rigid: int, n_soil: int):
    """Mean squared error of the N soil particles within the subspace, per run, m².

    Args:
      position, truth: [S, T, V, D]; the modes follow the first `n_rigid` nodes.
      n_rigid: R.
      n_soil: N.

    Returns:
      float64 [S], sum of squared score errors / (D N), mean over frames (Haeri & Skonieczny 2021).
    """
    error = (position - truth)[:, :, n_rigid:]
    return (error**2).sum(axis=(2, 3)).mean(axis=1) / (truth.shape[-1] * n_soil)


def rigid_mse(position, truth, n_rigid: int):
    """Mean squared error of the rigid particles per run, m², [S] (mean over particles, axes and
    frames)."""
    error = (position - truth)[:, :, :n_rigid]
    return (error**2).mean(axis=(1, 2, 3))


def force_errors(force, truth, name: str = 'force') -> dict[str, np.ndarray]:
    """Errors of a force, or of another load, per run.

    Args:
      force, truth: [S, T, D], N; of a torque N m.
      name: the first word of the errors.

    Returns:
      `force_relative_l2` = |F̂ - F| / |F| over all frames and axes, `force_rmse` in N per
      component, and `force_mpe` in percent: mean over frames of |F̂| against that of |F|, signed
      (Usmani & Skonieczny 2023, Table 3.3).
    """
    error = force - truth
    size, true_size = (np.linalg.norm(f, axis=-1).mean(axis=1) for f in (force, truth))
    with np.errstate(divide='ignore', invalid='ignore'):
        share = (error**2).sum(axis=(1, 2)) / (truth**2).sum(axis=(1, 2))
        return {
            f'{name}_relative_l2': np.sqrt(share),
            f'{name}_rmse': np.sqrt((error**2).mean(axis=(1, 2))),
            f'{name}_mpe': 100.0 * (size - true_size) / true_size,
        }


def stay_still(history, n_frame: int):
    """Trivial predictor: the last of the H input frames [S, H, V, D] for ever, [S, n_frame, V,
    D]."""
    return np.repeat(history[:, -1:], n_frame, axis=1)


def constant_velocity(history, n_frame: int):
    """Trivial predictor: the displacement of the last input frame goes on, [S, n_frame, V, D]."""
    step = history[:, -1:] - history[:, -2:-1]
    return history[:, -1:] + step * np.arange(1, n_frame + 1)[None, :, None, None]


def rms_mm(mse):
    """Root of a mean squared error in m², in mm per coordinate."""
    return 1e3 * np.sqrt(mse)


def run_errors(
    position, truth, force, true_force, n_rigid: int, n_soil: int | None, projection_mse=None
) -> dict:
    """All errors of one method on S runs; [S] arrays.

    Args:
      position, truth: [S, T, V, D], m.
      force, true_force: [S, T, D], N, or None.
      n_rigid: R.
      n_soil: N, or None: then scores are not turned into soil errors per particle.
      projection_mse: [S], m², what the subspace cuts off each run, or None if it is not known.
    """
    errors = {'rigid_mse': rigid_mse(position, truth, n_rigid)} if n_rigid else {}
    errors['soil_mse'] = soil_mse(position, truth, n_rigid, n_soil)
    errors['soil_rms_mm'] = rms_mm(errors['soil_mse'])
    if projection_mse is not None:
        errors['soil_mse_full'] = errors['soil_mse'] + projection_mse
        errors['soil_rms_mm_full'] = rms_mm(errors['soil_mse_full'])
    if force is not None and true_force is not None:
        errors |= force_errors(force, true_force)
    return errors


def skill(mse, trivial_mses) -> float:
    """1 - MSE / the best trivial MSE: 1 is perfect, 0 is no better than the best trivial
    predictor."""
    best = min(trivial_mses)
    return float(1.0 - mse / best) if best > 0 else float('nan')
