"""Measures all rows of a report and keeps what is finished in one JSON document."""

import dataclasses
import os
import re

import tqdm

from cluster import workers
from learning_to_simulate import checkpoints, reading_utils
from learning_to_simulate.edges import edge_lists
from learning_to_simulate.training import model_folder
from pca_tools import dataset
from reports import isolated, markdown, record
from reports.work_precision import families, measure, solver_rows
from reports.work_precision.points import (
    DOCUMENT,
    SCHEMA_VERSION,
    WorkPrecisionPoint,
    read_document,
    write_document,
)

REFERENCES = {'projection': markdown.FLOOR} | markdown.TRIVIAL


@dataclasses.dataclass(frozen=True)
class Settings:
    """What a survey does.

    Attributes:
      whole, sweeps: family -> rows, as `families.WHOLE` and `families.SWEEPS`.
      training: config fields that all swept rows share: the short training.
      models_path: folder whose models are loaded where they are what a row asks for, or None.
      seeds, sweep_seeds: trainings of the rows of `whole`, and of the swept rows.
      rounds: timed rollouts of each model.
      live_runs: test runs that each model is stepped through live.
      threads: CPU threads of TensorFlow.
      num_processes: rows trained at a time, here.
      cluster: where they are trained instead, see `cluster.workers`.
      row_limit_s: a row that trains longer has failed.
      time_again: whether all rows are timed again, those of an earlier call too: after a call on a
        busy machine.
      isolate: whether rows run in processes of their own.
      solver_json: rows of the solver on coarser grids, or None.
    """

    whole: dict
    sweeps: dict
    training: dict
    models_path: str | None
    seeds: int = 3
    sweep_seeds: int = 1
    rounds: int = 30
    live_runs: int = 3
    threads: int = 1
    num_processes: int = 1
    cluster: str = ''
    row_limit_s: float = 1800.0
    time_again: bool = False
    isolate: bool = True
    solver_json: str | None = None


class Survey:
    """One report in the making; call `run` again and it goes on where it was stopped.

    Args:
      data_path: dataset folder.
      work_path: folder for the models that are trained.
      output_path: folder of the report.
      settings: what to do.

    Raises:
      FileNotFoundError, ValueError: bad data, or a report of other data in `output_path`.
    """

    def __init__(self, data_path: str, work_path: str, output_path: str, settings: Settings):
        self._data, self._work, self._settings = data_path, work_path, settings
        metadata = dataset.read_metadata(data_path)
        groups = reading_utils.read_groups(data_path, 'test', metadata)
        scene = reading_utils.read_scene(data_path, metadata, groups, None)
        self._sha256 = model_folder.data_digests(data_path)
        self._rows = families.rows(
            settings.whole, settings.sweeps, settings.training, scene, settings.seeds,
            settings.sweep_seeds,
        )  # fmt: skip
        for folder in (work_path, output_path):
            os.makedirs(folder, exist_ok=True)
        self.path = os.path.join(output_path, DOCUMENT)
        self.document = {
            'schema_version': SCHEMA_VERSION,
            'scene': scene.name,
            'dt': scene.dt,
            'data_sha256': self._sha256,
            **record.provenance(settings.threads),
            'swept_training': settings.training,
            'points': [],
        }
        self._old = self._finished()
        self._points: dict[str, WorkPrecisionPoint] = {}
        self._references: list[WorkPrecisionPoint] = []
        path = settings.solver_json
        self._solver = solver_rows.read(path) if path else []
        self._models: dict[str, str] = {}

    def _finished(self):
        """digest -> finished point of an earlier call."""
        if not os.path.exists(self.path):
            return {}
        old = read_document(self.path)
        if old.get('data_sha256') != self._sha256:
            raise ValueError(
                f'{self.path}: is a report on other data ({old["scene"]}); nothing was written, '
                'give another --output_path'
            )
        failed = ('not_trained', 'not_measured')  # Worth another try: often the machine's fault.
        points = [p for p in old['points'] if p.status not in failed]
        if self._settings.time_again:
            points = [
                dataclasses.replace(p, rollout=None, live=None) if p.overrides else p
                for p in points
            ]
        return {p.digest: p for p in points}

    def run(self) -> dict:
        """Measures what is missing; returns the document, written after every row."""
        missing, settings = self._keep_finished(), self._settings
        limits = (settings.isolate, settings.row_limit_s, settings.threads)
        jobs = [(os.path.abspath(self._data), *job, limits) for job in missing]
        with (
            self._workers() as crew,
            tqdm.tqdm(desc='rows', total=len(jobs), unit='row', disable=None) as bar,
        ):
            for outcome in crew.run(measure_row, jobs):
                self._take(missing[outcome.index], outcome)
                bar.update()
        self._time()
        self._write()
        return self.document

    def _workers(self):
        settings = self._settings
        if settings.cluster:
            return workers.start(settings.cluster, settings.num_processes)
        # A row has a process of its own: threads wait for them.
        return workers.threads(settings.num_processes)

    def _take(self, job, outcome):
        row, _, digest, _ = job
        values, references = outcome.value or (
            {'status': 'not_trained', 'note': ' '.join(outcome.error.split())[:300]}, None
        )  # fmt: skip
        # Of a network on thinned particles they would be those of the particles it has.
        if references and not self._references and row.config.model != 'full_space':
            self._references = self._reference_points(references)
        self._points[digest] = WorkPrecisionPoint(
            label=row.label, families=row.families, seed=row.config.seed, digest=digest,
            overrides=row.overrides, **values,
        )  # fmt: skip
        self._write()

    def _keep_finished(self) -> list:
        """Takes over finished points; returns the arguments of `_measure` for the others."""
        found = []
        for row in self._rows:
            shipped = measure.find_shipped(self._settings.models_path, row.config, self._sha256)
            digest = measure.digest(row.config, self._sha256, self._files_used(row, shipped))
            name = re.sub(r'[^\w=]+', '_', row.label).strip('_')
            path = shipped or os.path.join(self._work, f'{name}_{digest[:8]}')
            found.append((row, path, digest, not shipped))
        old = [self._old.get(digest) for _, _, digest, _ in found]
        complete = all(p and not self._needs_time(p) for p in old)
        missing = []
        for (row, path, digest, train), point in zip(found, old, strict=True):
            self._models[digest] = path
            # To be timed in turns with new rows, the model of an old one must still be there.
            timed = point and point.runs and point.seed == 0
            if point and (complete or not timed or os.path.isdir(path)):
                self._points[digest] = dataclasses.replace(
                    point, label=row.label, families=row.families
                )
            else:
                missing.append((row, os.path.abspath(path), digest, train))
        return missing

    def _files_used(self, row, shipped):
        if shipped:
            return [os.path.join(shipped, checkpoints.WEIGHTS_FILE)]
        edges = os.path.join(self._data, edge_lists.FILE_NAME)
        return [edges] if row.config.adjacency == 'algorithm2' and os.path.exists(edges) else []

    @staticmethod
    def _needs_time(point):
        """Rollouts that fail take their time too; only models that do not exist take none."""
        return point.runs and point.seed == 0 and point.rollout is None

    def _reference_points(self, references):
        decoding = measure.time_decoding(self._data, self._settings.rounds)
        return [
            WorkPrecisionPoint(
                REFERENCES[name], (families.REFERENCE,), 0, f'reference {name}', runs=runs,
                rollout=decoding if name == 'projection' else None,
                note='time: particles of one frame from the modes' if name == 'projection' else '',
            )
            for name, runs in references.items()
        ]  # fmt: skip

    def _time(self):
        """Times all models in turns if one of them was not timed yet."""
        if not any(map(self._needs_time, self._points.values())):
            return
        paths = {d: self._models[d] for d, p in self._points.items() if p.runs and p.seed == 0}
        self.document['machine'] = record.facts(self._settings.threads)
        times = measure.time_rollouts(self._data, paths, self._settings.rounds)
        live = {}
        if os.path.exists(os.path.join(self._data, 'subspace.npz')):
            live = measure.time_live_steps(self._data, paths, self._settings.live_runs)
        for digest, timing in times.items():
            self._points[digest] = dataclasses.replace(
                self._points[digest], rollout=timing, live=live.get(digest)
            )

    def _write(self):
        if not self._references:
            self._references = [
                p for p in self._old.values() if p.families == (families.REFERENCE,)
            ]
        order = {row.label: i for i, row in enumerate(self._rows)}
        rows = sorted(self._points.values(), key=lambda p: (order[p.label], p.seed))
        self.document['points'] = [*self._references, *self._solver, *rows]
        write_document(self.path, self.document)


def measure_row(job: tuple) -> tuple[dict, dict | None]:
    """Trains and evaluates one row, on any machine that sees the folders.

    Args:
      job: (dataset folder, row, model folder, digest, whether it is to be trained, (whether in
        processes of its own, seconds that training may take, threads)).

    Returns:
      fields of `WorkPrecisionPoint`, and the references of `measure.evaluate` or None.
    """
    data, row, path, _, train, (isolate, limit_s, threads) = job

    def call(function, *arguments, limit_s=None):
        if not isolate:
            return function(*arguments)
        return isolated.call(function, *arguments, limit_s=limit_s, threads=threads)

    values, failure = {}, 'not_trained'
    try:
        if train:
            values['training_s'] = call(measure.train, data, path, row.config, limit_s=limit_s)
        failure = 'not_measured'
        measured = call(measure.evaluate, data, path)
    except (ValueError, OSError, RuntimeError) as error:  # TimeoutError is an OSError.
        return values | {'status': failure, 'note': ' '.join(str(error).split())[:300]}, None
    references = measured.pop('references')
    return values | measured, references
