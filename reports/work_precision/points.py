"""`WorkPrecisionPoint`: one row of the error-against-run-time report, and choices between rows."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from pca_tools import files
from reports.timing import Timing

DOCUMENT = 'points.json'
SCHEMA_VERSION = 1
OK = 'ok'
# A soil error this many times that of the better trivial predictor is a failure, not a result.
DIVERGED_RATIO = 10.0


@dataclasses.dataclass(frozen=True)
class WorkPrecisionPoint:
    """What one configuration costs and how wrong it is.

    Attributes:
      label: short name, the same for all seeds.
      families: curves that the row lies on.
      seed: of the training; 0 where nothing is drawn.
      digest: sha256 of what the row was made from: settings, data and, where a model was loaded
        instead of trained, its weights.
      overrides: preset and changed fields of the config; {} for rows without a network.
      status: 'ok', or why there is no usable number: 'not_trained', 'not_measured', 'non_finite',
        'diverged'.
      note: the failure in words, or what the reader of the row must know.
      n_node, n_edge, n_weight: V, E and trainable values; None where there is no network.
      runs: split -> error -> its value for every run; None where a run has none. Names and units
        as in `learning_to_simulate.metrics.run_errors`.
      rollout: ms per step of whole compiled rollouts, batch 1, results materialised; None if it
        was not timed.
      live: ms per call of single steps from Python, particles included.
      load_s, first_call_s: opening the model; its first rollout, compilation included, s.
      peak_memory_mb: of a process that opens the model and rolls it out; `base_memory_mb` of it is
        there before (TensorFlow itself).
      training_s: wall time of the training; None where a model was loaded.
    """

    label: str
    families: tuple[str, ...]
    seed: int
    digest: str
    overrides: dict = dataclasses.field(default_factory=dict)
    status: str = OK
    note: str = ''
    n_node: int | None = None
    n_edge: int | None = None
    n_weight: int | None = None
    runs: dict[str, dict[str, list]] = dataclasses.field(default_factory=dict)
    rollout: Timing | None = None
    live: Timing | None = None
    load_s: float | None = None
    first_call_s: float | None = None
    peak_memory_mb: float | None = None
    base_memory_mb: float | None = None
    training_s: float | None = None

    def error(self, split: str, name: str) -> float | None:
        """Mean of an error over the runs of a split; None if a run has none."""
        values = self.runs.get(split, {}).get(name)
        if not values or any(v is None or not math.isfinite(v) for v in values):
            return None
        return float(np.mean(values))

    def n_run(self, split: str) -> int:
        """Runs of a split that the row was measured on."""
        return max(map(len, self.runs.get(split, {}).values()), default=0)

    def position_error(self, split: str) -> float | None:
        """Soil error, mm RMS: in full space where the dataset states its truncation error, else
        within the subspace."""
        full = self.error(split, 'soil_rms_mm_full')
        return self.error(split, 'soil_rms_mm') if full is None else full

    def seconds_per_second(self, dt: float) -> float | None:
        """Median wall time per simulated second; `dt` is seconds per frame."""
        return None if self.rollout is None else 1e-3 * self.rollout.percentile(50) / dt

    def step_ms(self) -> float | None:
        """What a step must be allowed, ms: the 99th percentile, of live steps where they were
        timed."""
        timing = self.live or self.rollout
        return None if timing is None else timing.percentile(99)

    def to_json(self) -> dict:
        """The point as JSON-able values; `from_json` is the inverse up to the rounding of times."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values['families'] = list(self.families)
        for name in ('rollout', 'live'):
            values[name] = None if values[name] is None else values[name].to_json()
        return values

    @classmethod
    def from_json(cls, values: dict) -> 'WorkPrecisionPoint':
        """Rebuilds a point.

        Raises:
          ValueError: a field is missing, unknown or of the wrong kind.
        """
        try:
            timings = {
                name: None if values[name] is None else Timing.from_json(values[name])
                for name in ('rollout', 'live')
            }
            return cls(**values | timings | {'families': tuple(values['families'])})
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f'not a point of the report: {error!r}') from error


def read_document(path: str) -> dict:
    """Reads a stored report; its 'points' become `WorkPrecisionPoint`s.

    Raises:
      FileNotFoundError, ValueError: no report there, or one of another kind or version.
    """
    values = files.read_json(path)
    if not isinstance(values, dict) or values.get('schema_version') != SCHEMA_VERSION:
        raise ValueError(f'{path}: not a report of schema version {SCHEMA_VERSION}')
    try:
        read = [WorkPrecisionPoint.from_json(point) for point in values['points']]
        values['scene'], values['dt'], values['machine']
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{path}: {error!r}') from error
    return values | {'points': read}


def write_document(path: str, document: dict) -> None:
    """Writes a report, whole or not at all."""
    points = [point.to_json() for point in document['points']]
    files.write_json(path, document | {'points': points})


def over_seeds(points: Sequence[WorkPrecisionPoint]) -> list[WorkPrecisionPoint]:
    """One point per label, as a user meets it who trains once: errors of all seeds together.

    Args:
      points: rows; those of one label differ by their seed.

    Returns:
      the points of the lowest seeds, in the order of their labels, with the runs of all seeds and
      the status of the first seed that failed.
    """
    groups: dict[str, list[WorkPrecisionPoint]] = {}
    for point in points:
        groups.setdefault(point.label, []).append(point)
    merged = []
    for members in groups.values():
        members.sort(key=lambda p: p.seed)
        failed = next((p for p in members if p.status != OK), members[0])
        runs: dict[str, dict[str, list]] = {}
        for point in members:
            for split, errors in point.runs.items():
                for name, values in errors.items():
                    runs.setdefault(split, {}).setdefault(name, []).extend(values)
        merged.append(dataclasses.replace(members[0], runs=runs, status=failed.status))
    return merged


def pareto_front(costs: Sequence[tuple[float, float]]) -> np.ndarray:
    """Which points no other point beats in both costs.

    Args:
      costs: (time, error) of each point; smaller is better in both.

    Returns:
      bool array; of equal points all are on the front.
    """
    front = np.zeros(len(costs), bool)
    best = (math.inf, math.inf)
    for i in sorted(range(len(costs)), key=lambda i: costs[i]):
        # Later in this order means no faster, so only a smaller error, or an equal point, stays.
        if costs[i][1] < best[1] or costs[i] == best:
            front[i] = True
            best = costs[i]
    return front


def choose(
    points: Sequence[WorkPrecisionPoint], budget_ms: float, split: str = 'valid'
) -> WorkPrecisionPoint:
    """The most accurate model whose step fits a budget.

    Real time is lost by the slow steps, so the 99th percentile must fit, not the median. The error
    is the mean over seeds; rows without a network are no candidates, nor those that failed once.

    Args:
      points: measured rows.
      budget_ms: ms per step.
      split: decides which is the most accurate; 'valid', since the test split only reports.

    Raises:
      ValueError: no row was measured, or none is fast enough; the message names the fastest.
    """
    if not budget_ms > 0:
        raise ValueError(f'the budget is {budget_ms} ms per step, must be above 0')
    candidates = [
        (time, error, p)
        for p in over_seeds(points)
        if p.status == OK and p.overrides
        and (time := p.step_ms()) is not None and (error := p.position_error(split)) is not None
    ]  # fmt: skip
    if not candidates:
        raise ValueError(f'no model has both a time and an error on {split}; measure some first')
    affordable = [row for row in candidates if row[0] <= budget_ms]
    if not affordable:
        time, _, fastest = min(candidates, key=lambda row: row[0])
        raise ValueError(
            f'no model keeps {budget_ms:g} ms per step: the fastest, {fastest.label}, needs '
            f'{time:.3g} ms (99th percentile)'
        )
    return min(affordable, key=lambda row: row[1])[2]
