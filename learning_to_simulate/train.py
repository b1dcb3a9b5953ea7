"""Trains and evaluates a simulator of soil modes.

Examples:
  # train the default model on a dataset folder, resume by giving the same command again
  python -m learning_to_simulate.train --data_path=datasets/excavation --model_path=/tmp/pcg

  # roll out the test split: rollout_test_*.npz and metrics.json
  python -m learning_to_simulate.train --mode=eval_rollout --eval_split=test \\
      --data_path=datasets/excavation --model_path=/tmp/pcg --output_path=/tmp/pcg/rollouts

  # one-step errors on the validation split
  python -m learning_to_simulate.train --mode=eval --eval_split=valid \\
      --data_path=... --model_path=...

  # other networks on the same state: an MLP, a Motion-Mixer with SE or scSE
  python -m learning_to_simulate.train --model=mlp --data_path=... --model_path=...

  # published baselines, a loaded edge list, the authors' wheel with its measured motion
  python -m learning_to_simulate.train --preset=fcg_original --data_path=... --model_path=...
  python -m learning_to_simulate.train --adjacency=edges.json --data_path=... --model_path=...
  python -m learning_to_simulate.train --rigid_motion=driven --data_path=Wheel_PCA --model_path=...

Model flags that are not given take the preset's value; in the other modes they are read from the
model and a flag that contradicts them is refused.
"""

import inspect
import re

import tqdm
from absl import flags

from learning_to_simulate import command, presets, registry

_MODE = flags.DEFINE_enum(
    'mode', 'train', ['train', 'eval', 'eval_rollout'], 'Train, or evaluate a trained model.'
)
_EVAL_SPLIT = flags.DEFINE_enum(
    'eval_split', 'test', ['train', 'valid', 'test'], 'Split to evaluate on.'
)
_DATA_PATH = flags.DEFINE_string(
    'data_path', None, 'Dataset folder (metadata.json, *.tfrecord).', required=True
)
_MODEL_PATH = flags.DEFINE_string(
    'model_path', None, 'Model folder; training resumes from it.', required=True
)
_RAW_PATH = flags.DEFINE_string(
    'raw_path', None, 'Raw runs of the dataset, for models on particles; else they are decoded.'
)
_OUTPUT_PATH = flags.DEFINE_string(
    'output_path', None, 'Folder for rollouts and metrics.json (eval_rollout).'
)
_PRESET = flags.DEFINE_string(
    'preset',
    None,
    f'One of {", ".join(registry.all_presets())}; default: the one of --model, else pcg.',
)
_MODEL = flags.DEFINE_string(
    'model',
    None,
    "Method; overrides the preset's: "
    + '; '.join(f'{name}, {method.about}' for name, method in registry.METHODS.items()),
)
_ADJACENCY = flags.DEFINE_string(
    'adjacency',
    None,
    'edges.json, mask.npy, fully_connected, algorithm2, correlation, random or none.',
)
_RIGID_MOTION = flags.DEFINE_string(
    'rigid_motion',
    None,
    "Overrides the scene's: prescribed, driven (height predicted) or predicted.",
)
_RIGID_CORRECTION = flags.DEFINE_bool(
    'rigid_correction', True, 'Keep predicted bodies rigid in rollouts.'
)
_SAVE_EVERY = flags.DEFINE_integer(
    'save_every', None, 'Steps between checkpoints; default: a tenth of all steps.', 1
)
_TAKE_OVER_LOCK = flags.DEFINE_bool(
    'take_over_lock',
    False,
    'Train in a folder that a dead process of another machine left locked.',
)
flags.DEFINE_integer('num_threads', None, 'CPU threads of TensorFlow; default: its own choice.', 1)


def _meanings(settings: type) -> dict[str, str]:
    """Field -> what the docstrings of a class of settings and of its parts say of it."""
    found = {}
    for part in settings.__mro__:
        text = (inspect.cleandoc(part.__doc__ or '')).split('Attributes:')[-1]
        for names, meaning in re.findall(r'^  ([\w, ]+): (.*(?:\n    .*)*)', text, re.M):
            found |= {name: ' '.join(meaning.split()) for name in names.split(', ')}
    return found


# Flags that override single fields of the preset's config; DeepMind's spelling where it has one.
_FIELD_FLAGS = {'message_passing_steps': 'mssg'}
for _field, (_type, _settings) in registry.setting_fields().items():
    if _field in ('preset', 'model', 'adjacency'):
        continue
    _define = {
        int: flags.DEFINE_integer,
        float: flags.DEFINE_float,
        bool: flags.DEFINE_bool,
        str: flags.DEFINE_string,
    }[_type]
    _FIELD_FLAGS.setdefault(_field, _field)
    _meaning = _meanings(_settings).get(_field, 'see the settings')
    _define(_FIELD_FLAGS[_field], None, f"{_meaning} (default: the preset's)")


def _overrides() -> dict:
    """Config fields that the command line gives."""
    given = {field: flags.FLAGS[flag].value for field, flag in _FIELD_FLAGS.items()}
    given |= {'model': _MODEL.value, 'adjacency': _ADJACENCY.value}
    return {k: v for k, v in given.items() if v is not None}


def _open(overrides) -> registry.OpenedModel:
    """The trained model and the runs of the split."""
    from learning_to_simulate import checkpoints

    preset, motion = _PRESET.value, _RIGID_MOTION.value
    opened = registry.open_model(
        _MODEL_PATH.value,
        _DATA_PATH.value,
        _EVAL_SPLIT.value,
        overrides if preset is None else overrides | {'preset': preset},
        raw_path=_RAW_PATH.value,
        rigid_correction=_RIGID_CORRECTION.value,
    )
    if motion is not None:
        scene = opened.model.simulator.scene
        checkpoints.refuse_contradictions(_MODEL_PATH.value, scene, {'rigid_motion': motion})
    return opened


def _train(overrides):
    config = presets.make_config(
        _PRESET.value or presets.preset_of_model(_MODEL.value), **overrides
    )
    registry.train(
        _DATA_PATH.value,
        _MODEL_PATH.value,
        config,
        rigid_motion=_RIGID_MOTION.value,
        save_every=_SAVE_EVERY.value,
        take_over_lock=_TAKE_OVER_LOCK.value,
        raw_path=_RAW_PATH.value,
    )


def _evaluate_one_step(overrides):
    opened = _open(overrides)
    print(f'one-step errors on {_EVAL_SPLIT.value} of {_DATA_PATH.value}')
    for name, value in opened.one_step_errors().items():
        print(f'  {name:24s} {value:.6g}')


def _evaluate_rollouts(overrides):
    from learning_to_simulate import checkpoints, evaluation

    if not _OUTPUT_PATH.value:
        raise ValueError('--mode=eval_rollout needs --output_path')
    split = _EVAL_SPLIT.value
    command.writable_folder(_OUTPUT_PATH.value)
    opened = _open(overrides)
    results, summary = opened.evaluator.run(
        opened.groups, split, lambda runs: tqdm.tqdm(runs, unit='run', disable=None)
    )
    written = evaluation.save_rollouts(
        _OUTPUT_PATH.value, split, results, summary, opened.metadata,
        checkpoints.folder_digest(_MODEL_PATH.value),
    )  # fmt: skip
    print(evaluation.table(summary))
    print(f'wrote {len(written)} files to {_OUTPUT_PATH.value}')


def run(values) -> None:
    """Runs the chosen mode."""
    overrides = _overrides()
    command.import_tensorflow(values.num_threads)
    if values.mode == 'train':
        _train(overrides)
    elif values.mode == 'eval':
        _evaluate_one_step(overrides)
    else:
        _evaluate_rollouts(overrides)


if __name__ == '__main__':
    command.start(run)
