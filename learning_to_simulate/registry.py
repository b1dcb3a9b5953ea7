"""The methods: what `--model` can be. The only list of them; nothing else asks for a name.

The modules of a method are imported when they are needed: a look at the list loads no TensorFlow.
The module of its `code` has three functions:

  train(data_path, model_path, config, options: TrainOptions) -> dict
      See `train` below. Leaves a model folder: `config.json` with `schema_version` and, under
      `config`, the settings with the method's name as `model`.
  open_model(model_path, data_path, split, raw_path=None) -> OpenedModel
      A trained model with the runs of a split; refuses data that it does not fit.
  load(model_path) -> model

and, where the method `steps`, a class `Step`: frames of (model, R), as `live.stepper.TfStep`.

Its settings are a frozen dataclass with the fields `preset` and `model`; `presets` lists those of
all methods.
"""

import dataclasses
import importlib
from types import ModuleType
from typing import Any

from learning_to_simulate import checkpoints, command


@dataclasses.dataclass(frozen=True)
class Method:
    """How a method is reached, and which shared options apply to it."""

    about: str  # one line for `--help`
    code: str  # module with `train`, `open_model` and `load`
    takes_raw_runs: bool = False  # of a dataset (`raw_path`), not records alone
    on_terrain: bool = False  # whether its models work on a given terrain: `api.TerrainModel`
    steps: bool = True  # whether its models start from a bed and take poses, live or as paths

    def check_raw_path(self, raw_path: str | None) -> None:
        if raw_path and not self.takes_raw_runs:
            names = [name for name, method in METHODS.items() if method.takes_raw_runs]
            raise ValueError(
                f'--raw_path is for --model={", ".join(names)} only; other models take records'
            )

    def load_code(self) -> ModuleType:
        command.import_tensorflow()
        return importlib.import_module(self.code)


@dataclasses.dataclass
class OpenedModel:
    """A trained model with the runs that it is judged on."""

    model: Any  # of the method's `load`
    groups: list  # of `RunGroup`
    metadata: dict  # of the dataset
    evaluator: Any  # as `evaluation.Evaluator`: `run(groups, split, progress)`
    one_step_errors: Any  # called without arguments it gives {name: error} of single steps


@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """How a training is run, beside what is trained."""

    rigid_motion: str | None = None  # override of the scene's
    save_every: int | None = None  # see `steps_between_saves`
    raw_path: str | None = None  # raw runs, for models on particles; None to decode the records
    initial_weights: str | None = None  # folder of a soil field that another one starts from
    num_processes: int = 1  # that make the samples of a soil field

    def steps_between_saves(self, num_steps: int) -> int:
        """Steps between checkpoints of a training of `num_steps`: `save_every`, else a tenth of
        them, at least 100."""
        return self.save_every or max(num_steps // 10, 100)


_SUBSPACE = 'learning_to_simulate.subspace.method'
METHODS = {
    'gns': Method('graph network on modes and body (Usmani & Skonieczny 2023)', _SUBSPACE),
    'mlp': Method('plain MLP on the subspace state (Holden et al. 2019)', _SUBSPACE),
    'mixer_se': Method(
        'Motion-Mixer with squeeze-and-excitation (Bouazizi et al. 2022)', _SUBSPACE
    ),
    'mixer_scse': Method('Motion-Mixer with scSE', _SUBSPACE),
    'full_space': Method(
        'radius graph on thinned particles (Sanchez-Gonzalez et al. 2020)',
        'learning_to_simulate.full_space.method',
        takes_raw_runs=True,
    ),
    'soil_field': Method(
        'neural field over what a tool has swept, anywhere on a terrain of heights',
        'learning_to_simulate.soil_field.method',
        on_terrain=True,
    ),
    'path_ridge': Method(
        'kernel ridge on the path so far, no dynamics: a baseline',
        'learning_to_simulate.baselines.method',
        steps=False,
    ),
}


def train(data_path: str, model_path: str, config, **options) -> dict:
    """Trains the method of `config` to its end, or goes on with a training, or finds it done.

    Args:
      data_path: dataset folder with a train split; valid, where there is one, is rolled out. Of a
        soil field several folders, separated by commas.
      model_path: model folder, made if absent; locked while the training runs.
      config: settings, as of `presets.make_config`.
      **options: of `TrainOptions`.

    Returns:
      the metrics of the last validation rollout.

    Raises:
      ValueError: bad data, edges, settings or options; a folder of something else, or with another
        writer; only damaged checkpoints; a loss that is not finite.
      OSError: a file could not be read or written.
      SystemExit: with 130 after Ctrl-C, 143 after SIGTERM, where steps are saved on the way.
    """
    method, how = METHODS[config.model], TrainOptions(**options)
    method.check_raw_path(how.raw_path)
    if how.initial_weights and not method.on_terrain:
        raise ValueError(f'--initial_weights is for a soil field, not for {config.model}')
    return method.load_code().train(data_path, model_path, config, how)


def open_model(
    model_path: str,
    data_path: str,
    split: str,
    overrides: dict | None = None,
    raw_path: str | None = None,
) -> OpenedModel:
    """The model of any method with the runs of a split; see above. ValueError, too, for overrides
    {field: value} that are not what its settings or its scene say."""
    method = of_folder(model_path)
    method.check_raw_path(raw_path)
    checkpoints.refuse_contradictions(model_path, overrides or {})
    return method.load_code().open_model(model_path, data_path, split, raw_path)


def of_folder(model_path: str) -> Method:
    """The method of a model folder; FileNotFoundError, ValueError: no model there, or one of a
    method that does not exist."""
    config = checkpoints.read_config(model_path).get('config')
    name = config.get('model', 'gns') if isinstance(config, dict) else None
    if name not in METHODS:
        raise ValueError(
            f'{model_path}/{checkpoints.CONFIG_FILE}: model is {name!r}; there are '
            f'{", ".join(METHODS)}'
        )
    return METHODS[name]
