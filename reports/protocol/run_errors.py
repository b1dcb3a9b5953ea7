"""The errors of one prediction of one run."""

import dataclasses
from typing import Any

import numpy as np

from learning_to_simulate import metrics


@dataclasses.dataclass(frozen=True)
class RunPrediction:
    """What a method says of frames H .. T - 1 of one run; None where it says nothing.

    Attributes:
      modes: float64 [T - H, r, 3] scores, m; the soil, where `own` holds no particles.
      own: predicted particles as a rollout file has them (`soil_truth.SoilTruth.of_rollout`).
      force: [T - H, 3], N.
      height: [T - H] of the body's mean particle, m.
      torque: [T - H, 3], N m.
      status: of the rollout, or None.
    """

    modes: np.ndarray | None = None
    own: dict = dataclasses.field(default_factory=dict)
    force: np.ndarray | None = None
    height: np.ndarray | None = None
    torque: np.ndarray | None = None
    status: str | None = None

    def soil(self, truth) -> np.ndarray | None:
        """[F, P, 3] m, its particles in the frames of a `truth.Truth`; None without any."""
        if self.modes is None and not self.own:
            return None
        return truth.soil.of_rollout(self.modes, self.own)


def run_errors(prediction: RunPrediction, truth) -> dict:
    """All errors of one run; quantities that the method or the data lack are absent.

    Args:
      prediction: of the method.
      truth: `truth.Truth` of the run.

    Returns:
      `soil_mm` (see `soil_truth`); of force, `drawbar` and `vertical`, torque and `pitch` (see
      `metrics.load_errors`): `force_l2`, `force_n` (root mean square per component, N or N m),
      `force_peak_n` and so on; `height_mm`, `status`.
    """
    errors: dict[str, Any] = {}
    if (soil := prediction.soil(truth)) is not None:
        if soil.shape != truth.soil.particles.shape:
            raise ValueError(
                f'predicted particles {soil.shape} do not fit the truth '
                f'{truth.soil.particles.shape}'
            )
        errors['soil_mm'] = truth.soil.soil_mm(soil)
    along, up, across = truth.axes
    loads = (
        ('force', prediction.force, truth.force, slice(None)),
        ('drawbar', prediction.force, truth.force, slice(along, None, 3)),
        ('vertical', prediction.force, truth.force, slice(up, None, 3)),
        ('torque', prediction.torque, truth.torque, slice(None)),
        ('pitch', prediction.torque, truth.torque, slice(across, None, 3)),
    )
    for name, load, true_load, axis in loads:
        if load is None or true_load is None:
            continue
        found = metrics.force_errors(load[None, :, axis], true_load[None, :, axis], name)
        for short, key in (('l2', 'relative_l2'), ('n', 'rmse'), ('peak_n', 'peak_error')):
            errors[f'{name}_{short}'] = float(found[f'{name}_{key}'][0])
    if prediction.height is not None and truth.height is not None:
        errors['height_mm'] = float(1e3 * np.sqrt(((prediction.height - truth.height) ** 2).mean()))
    if prediction.status is not None:
        errors['status'] = prediction.status
    return errors
