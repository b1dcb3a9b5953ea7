"""What a run did: the particles of the solver where the dataset keeps them, else what its modes
decode to (`learning_to_simulate.soil_truth`), its loads and its body."""

import dataclasses
import os

import numpy as np

from learning_to_simulate import metrics, reading_utils, soil_truth
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.soil_truth import SoilTruth, of_run
from learning_to_simulate.tool import bed
from pca_tools import dataset

# Kind of runs of the case grid, which state none.
GRID = 'grid'


@dataclasses.dataclass(frozen=True)
class Truth:
    """One run, after the H frames that methods are given.

    Attributes:
      record: index in its split.
      case: number of its case.
      kind: of run, e.g. `grid`, `lift`.
      soil: `SoilTruth`, of P particles in F frames.
      truncation: root mean square, mm, of what the subspace cuts off the run; None if unknown.
      motion: root mean square, mm, of the soil's displacement in the run.
      modes: float64 [T - H, r, 3] recorded scores, m.
      force: float64 [T - H, 3], N (of several bodies one behind the other), or None.
      height: float64 [T - H] of the body's mean particle, m, or None where it is given.
      torque: float64 [T - H, 3] about the body's reference point, N m, or None.
      axes: along the body's way, up and across.
      spacing: between particles of the solver, m.
    """

    record: int
    case: object
    kind: str
    soil: SoilTruth
    truncation: float | None
    motion: float
    modes: np.ndarray
    force: np.ndarray | None
    height: np.ndarray | None
    torque: np.ndarray | None
    axes: tuple[int, int, int]
    spacing: float


class TruthReader(soil_truth.TruthReader):
    """Reads the runs of a dataset, one at a time.

    Args:
      folder: dataset folder.

    Raises:
      FileNotFoundError: no dataset, or one without `subspace.npz` (nothing can be judged in full
        space without it).
      ValueError: a damaged or foreign file.
    """

    def __init__(self, folder: str):
        super().__init__(folder)
        if self.subspace is None:
            path = os.path.join(folder, 'subspace.npz')
            raise FileNotFoundError(
                f'{path}: no such file; errors in full space need the subspace of the records'
            )

    def runs(self, split: str):
        """Yields the `Truth` of each run of a split, in file order."""
        sample, runs = self.sample(split), dataset.read_split(self.folder, split)
        if sample is not None and len(sample) != len(runs):
            raise ValueError(
                f'{self.folder}: {split} has {len(runs)} records, its particles are of '
                f'{len(sample)} runs'
            )
        for record, run in enumerate(runs):
            yield self._truth(split, record, run)

    def _truth(self, split, record, run):
        metadata = self.metadata
        case = of_run(metadata.get('cases'), split, record) or {}
        scores = run.position[:, run.n_rigid :].astype(np.float64)
        soil = self.read(split, record, scores, None)
        floor = of_run(metadata.get('projection_mse'), split, record)
        motion = of_run(metadata.get('motion_mse'), split, record)
        if soil.space == soil_truth.PARTICLES:
            floor = soil.mean_square(soil.of_modes(scores[H:])).mean()
            motion = None
        if motion is None:
            motion = ((soil.particles - soil.start) ** 2).mean()
        up = metadata.get('scene', {}).get('up_axis', 1)
        driven = metadata.get('scene', {}).get('rigid_motion') == 'driven'
        body = run.position[H:, : run.n_rigid].astype(np.float64)
        force = reading_utils.force_of(run)
        return Truth(
            record=record,
            case=case.get('case', record),
            kind=case.get('kind') or GRID,
            soil=soil,
            truncation=None if floor is None else float(1e3 * np.sqrt(floor)),
            motion=float(1e3 * np.sqrt(motion)),
            modes=scores[H:],
            force=None if force is None else force[H:],
            height=body[..., up].mean(axis=1) if driven else None,
            torque=None if run.torque is None else run.torque[H:].astype(np.float64),
            axes=metrics.travel_axes(body, up),
            spacing=bed.solver_spacing(case)
            or bed.kept_spacing(self.subspace.initial),
        )
