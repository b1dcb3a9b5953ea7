"""What a user types: models, datasets, training, by `import learning_to_simulate as lts`."""

import dataclasses
import functools
import os
from collections.abc import Sequence

import numpy as np

from learning_to_simulate import command, presets, registry, shipped
from pca_tools import dataset, files
from pca_tools.subspace import Subspace


@dataclasses.dataclass(frozen=True)
class Run:
    """One recorded run of a dataset, number `index` of a `split`; `model.rollout` takes it."""

    split: 'Split'
    index: int

    @property
    def name(self) -> str:
        """Such as `test_0`."""
        return f'{self.split.name}_{self.index}'


class Split(Sequence):
    """The runs of one split (train, valid or test) of a dataset folder; read when first asked
    for."""

    def __init__(self, folder: str, name: str):
        self.folder, self.name = folder, name

    @functools.cached_property
    def records(self) -> list[dataset.Trajectory]:
        """The recorded runs, in file order; raises as `pca_tools.dataset.read_split`."""
        command.import_tensorflow()
        return dataset.read_split(self.folder, self.name)

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, index: int) -> Run:  # type: ignore[override]  # no slices
        if not -len(self) <= index < len(self):
            raise IndexError(f'{self.name} of {self.folder} has {len(self)} runs, not {index}')
        return Run(self, index % len(self))


class Dataset:
    """A dataset folder.

    Args:
      path: folder, or the name of a shipped one ('excavation', 'wheel').

    Attributes:
      metadata: checked.
      train, valid, test: its splits.

    Raises:
      FileNotFoundError, ValueError: no dataset there, or a damaged one.
    """

    def __init__(self, path: str):
        self.path = shipped.find(path, 'datasets')
        self.metadata = dataset.read_metadata(self.path)
        self.train, self.valid, self.test = (Split(self.path, name) for name in dataset.SPLITS)

    def __repr__(self) -> str:
        runs = {name: len(part) for name, part in self.metadata.get('dataset_split', {}).items()}
        return f'<dataset {self.path!r}: {runs or "runs not listed"}>'

    @property
    def subspace(self) -> Subspace | None:
        """Of the soil's modes, or None where the folder has none."""
        path = os.path.join(self.path, 'subspace.npz')
        return Subspace.load(path) if os.path.exists(path) else None


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Errors of a model on a split: `summary` is what `metrics.json` holds, `str` the table of it
    beside the trivial predictors."""

    summary: dict

    def __str__(self) -> str:
        from learning_to_simulate import evaluation

        return evaluation.table(self.summary)

    def save(self, path: str) -> None:
        """Writes the summary as JSON, whole or not at all."""
        files.write_json(path, self.summary)


class TrainedModel:
    """A trained model from its folder `path`; a `TerrainModel` where it is a soil field.

    Attributes:
      model: `subspace_model.Model`, of a soil field `SoilField`; else as the method's `load`.

    Raises:
      FileNotFoundError, ValueError: no model there, or a damaged one.
    """

    def __new__(cls, path: str):
        is_field = cls is TrainedModel and registry.of_folder(path).on_terrain
        return super().__new__(TerrainModel if is_field else cls)

    def __init__(self, path: str):
        self.path = path
        self._method = registry.of_folder(path)
        self.model = self._method.load_code().load(path)
        self._newest: tuple | None = None

    def __repr__(self) -> str:
        return f'<{self.config.model} model {self.path!r} of the scene {self.scene.name!r}>'

    @property
    def scene(self):
        """The `Scene` it was trained on."""
        return self.model.simulator.scene

    @property
    def config(self):
        """Its settings."""
        return self.model.simulator.config

    @property
    def starts(self):
        """`live.starts.Starts`: beds, bodies and contexts to start from. FileNotFoundError of a
        folder from before models carried them; ValueError of a model that is not stepped."""
        return self._at_rest[0]

    @property
    def subspace(self) -> Subspace | None:
        """The modes that the model predicts; raises as `starts`."""
        return self._at_rest[1]

    @functools.cached_property
    def _at_rest(self):
        if not self._method.steps:
            raise ValueError(
                f'{self.path}: {self.config.model} is a baseline for recorded runs: it has no live '
                f'stepping and no paths'
            )
        self.scene.check_one_body('stepping and rolling out by poses')
        from learning_to_simulate.live import starts

        return starts.read(self.path)

    def stepper(self, outside: str = 'flag', engine: str = 'best'):
        """A `live.stepper.Stepper`; `start` and `step` it with poses.

        Frames come from the C library where there is a C compiler and the model has a C form, else
        from TensorFlow: the same to round-off. `stepper.engine` says which, and why not C.

        Args:
          outside: what is done with a frame that is not `ok`: 'flag', 'hold' or 'raise'.
          engine: 'best', or 'c' or 'tensorflow' alone.

        Raises:
          FileNotFoundError, ValueError: as `starts`.
          native.library.NoCompiler: of 'c', where there is no C compiler.
        """
        from learning_to_simulate.native import engines

        starts, space = self._at_rest
        step = self._method.load_code().Step
        return engines.stepper(self.model, starts, space, engine, step, outside=outside)

    def rollout(self, path, velocity=None, case: int | str | None = None, context=None):
        """Rolls out a whole path, or a recorded run.

        Args:
          path: [T, 7] or [T, 3] poses of the body, one a frame (see `poses`): the body is at the
            first when the rollout starts, and the rollout has the T - 1 frames after it. Or a `Run`
            of a dataset.
          velocity, case: of `Stepper.start`; the velocity is by default that of the first two
            poses.
          context: likewise, or [T, C] where it changes in time.

        Returns:
          `paths.SoilRollout`.

        Raises:
          ValueError: not a path; a run of a dataset that the model does not fit, or velocity,
            case or context beside it.
        """
        if isinstance(path, Run):
            if not (velocity is case is context is None):
                raise ValueError('a recorded run has its own velocity, case and context')
            return self._of_run(path)
        from learning_to_simulate.live import paths

        return paths.roll_out(self._roller, path, velocity, case, context)

    @functools.cached_property
    def _roller(self):
        return self.stepper()

    def _of_run(self, run):
        from learning_to_simulate.live import paths

        opened = self._opened(run.split)
        (group,) = (
            g.take(np.flatnonzero(g.record == run.index)) for g in opened.groups
            if run.index in g.record
        )  # fmt: skip
        rollout = opened.evaluator.roll_out(group)
        decoder = self._decoder(run.split)
        return paths.of_recorded_run(group, rollout, self.scene, decoder, f'rollout_{run.name}')

    def _decoder(self, split):
        from learning_to_simulate.live.soil import Decoder

        space = Dataset(split.folder).subspace
        if space is None:  # records alone
            has_own = self._method.steps and not self.scene.bodies
            space = self.subspace if has_own else None
            return None if space is None else Decoder(space, self.scene.up_axis)
        if space.n_modes < self.scene.n_modes:  # a model on particles
            return self.model.decoder()
        return Decoder(space.truncated(self.scene.n_modes), self.scene.up_axis)

    def _opened(self, split):
        """The model with the runs of a split. The newest is kept, so that rollouts of single runs
        compile once; a new `Dataset` is read anew, as its files may have changed."""
        if self._newest is None or self._newest[0] is not split:
            self._newest = split, registry.open_model(self.path, split.folder, split.name)
        return self._newest[1]

    def evaluate(self, split, progress=iter) -> Evaluation:
        """Rolls out every run of a split, such as `Dataset('excavation').test`; of a soil field,
        also of a list of splits of several datasets. `progress` wraps the iterable of runs, e.g.
        `tqdm.tqdm`.

        Raises:
          FileNotFoundError, ValueError: no such split, or a dataset that the model does not fit.
        """
        splits = split if isinstance(split, (list, tuple)) else [split]
        if len(splits) != 1 and not self._method.on_terrain:
            raise ValueError(f'{len(splits)} splits: only a soil field takes more than one')
        opened = self._opened(*splits)
        return Evaluation(opened.evaluator.run(opened.groups, splits[0].name, progress)[1])

    def export(self, path: str, data: Dataset, kind: str = 'savedmodel') -> dict:
        """Writes a model that runs without this project to a folder `path`, absent or empty, and
        returns the description that is also in `export.json`.

        Args:
          data: gives runs to compare on.
          kind: one of `exporting.FORMATS`: savedmodel, tflite (LiteRT), onnx, c; of a soil field
            c or fmu.

        Raises:
          ValueError, OSError: as `exporting.export`.
        """
        from learning_to_simulate.export import exporting

        return exporting.export(self.path, data.path, path, kind)


class TerrainModel(TrainedModel):
    """A trained model of a tool anywhere on a terrain, `model` a `soil_field.field.SoilField`."""

    def __repr__(self) -> str:
        return f'<soil field {self.path!r} of a {self.model.networks.tool.name}>'

    @property
    def scene(self):
        """ValueError: there is none."""
        raise ValueError(f'{self.path}: a soil field works on a terrain and has no scene')

    @property
    def config(self):
        """Its settings."""
        return self.model.config

    @functools.cached_property
    def _at_rest(self):
        raise ValueError(
            f'{self.path}: a soil field has no recorded starts: it begins on a terrain, '
            f'`model.stepper(lts.Terrain(...))`'
        )

    def stepper(  # type: ignore[override]
        self, terrain=None, tool=None, members: int | None = None, engine: str = 'best'
    ):
        """A `soil_field.stepper.SoilStepper`; `start` and `step` it with poses.

        Args:
          terrain: `Terrain`, which the tool changes; several steppers may work on one.
          tool: `Blade` or `Wheel`, of the kind that the model knows; None for the usual one.
          members: networks that answer, of those that were trained; None: all.
          engine: 'best', or 'c' or 'tensorflow' alone.

        Raises:
          ValueError: no terrain, a tool of another kind, too many members, an unknown engine.
        """
        from learning_to_simulate.soil_field.stepper import SoilStepper
        from learning_to_simulate.soil_field.terrain import Terrain

        if not isinstance(terrain, Terrain):
            raise ValueError(
                f'terrain is {terrain!r}: an lts.Terrain was expected, such as '
                f'model.stepper(lts.Terrain.flat((12.0, 3.0), height=0.25))'
            )
        return SoilStepper(self.model, terrain, tool, members, engine)

    def rollout(  # type: ignore[override]
        self, path, terrain=None, tool=None, dt: float | None = None, under_load: bool = False
    ):
        """Sets a tool down and goes along a whole path, or along that of a recorded run.

        Args:
          path: [T, 7] poses, one a frame; or [T, 3] of (x, height, angle), in the middle of the
            terrain; or a `Run` of a dataset, on its own bed.
          terrain: of a path: what it begins on; is changed.
          tool, dt: of a path, s of a frame; None for the usual tool and 1/60.
          under_load: of a recorded run: whether its tool follows what moved it, not its path.

        Returns:
          `soil_field.rollout.TerrainRollout`.

        Raises:
          ValueError: not a path; a path that the model refuses; a run that the model does not fit.
        """
        if isinstance(path, Run):
            if not (terrain is tool is dt is None):
                raise ValueError('a recorded run has its own terrain, tool and time step')
            opened = self._opened(path.split)
            return opened.evaluator.roll_out(opened.groups[path.index], under_load)
        if under_load:
            raise ValueError('under_load is for recorded runs: lts.LoadedTool moves others')
        from learning_to_simulate.live import poses
        from learning_to_simulate.soil_field.rollout import DT, roll_out

        stepper = self.stepper(terrain, tool)
        values = poses.numbers('path', path, (None, 7), (None, 3))
        middle = float(terrain.corner[1] + terrain.cell[1] * terrain.shape[1] / 2)
        whole = [poses.read_pose(p, up_axis=1, lateral=middle) for p in values]
        return roll_out(stepper, whole, DT if dt is None else dt)

    def _opened(self, *splits):
        names = sorted({part.name for part in splits})
        if len(names) != 1:
            raise ValueError(f'splits are {names}: some of one name were expected')
        folders = ','.join(part.folder for part in splits)
        return self._method.load_code().opened(self.model, self.path, folders, names[0])


def load(name: str) -> TrainedModel:
    """The model of a folder, or a shipped one: 'excavation/pcg'; the name of a scene alone
    ('excavation', 'wheel') means its soil field.

    Raises:
      FileNotFoundError: no such model; the message lists those that ship.
      ValueError: damaged files.
    """
    return TrainedModel(shipped.find(name, 'models'))


def preset(name: str, **fields):
    """The settings of a preset with single fields replaced; ValueError for an unknown preset or
    field, or a value outside its range."""
    return presets.make_config(name, **fields)


def train(
    config, data: Dataset | Sequence[Dataset], path: str, save_every: int | None = None
) -> TrainedModel:
    """Trains a model, or goes on with its training, and opens it.

    Args:
      config: of `preset`.
      data: dataset with a train split; of a soil field one or several.
      path: model folder, made if absent.
      save_every: steps between checkpoints; None for a tenth of all, 100 at least.

    Raises:
      ValueError, OSError, SystemExit: as `registry.train`.
    """
    path = os.fspath(path)
    several = [data] if isinstance(data, Dataset) else data
    registry.train(','.join(d.path for d in several), path, config, save_every=save_every)
    return TrainedModel(path)
