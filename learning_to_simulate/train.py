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

import dataclasses
import sys

import tensorflow as tf
import tqdm
from absl import app, flags, logging

from learning_to_simulate import checkpoints, evaluation, experiment, presets
from learning_to_simulate.full_space import experiment as particles
from learning_to_simulate.full_space.particle_rollout import ParticleEvaluator
from learning_to_simulate.full_space.particle_training import ParticleTrainer
from learning_to_simulate.training import Trainer

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
    'raw_path', None, 'Raw runs of the dataset, for --model=full_space; else they are decoded.'
)
_OUTPUT_PATH = flags.DEFINE_string(
    'output_path', None, 'Folder for rollouts and metrics.json (eval_rollout).'
)
_PRESET = flags.DEFINE_string(
    'preset',
    None,
    f'One of {", ".join(presets.PRESETS)}; default: the one of --model, else pcg.',
)
_MODEL = flags.DEFINE_string(
    'model', None, f"Network, one of {', '.join(presets.MODELS)}; overrides the preset's."
)
_ADJACENCY = flags.DEFINE_string(
    'adjacency', None, 'edges.json, mask.npy, fully_connected, algorithm2 or none.'
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
_NUM_THREADS = flags.DEFINE_integer(
    'num_threads', None, 'CPU threads of TensorFlow; default: its own choice.', 1
)

# Flags that override single fields of the preset's config; DeepMind's spelling where it has one.
_FIELD_FLAGS = {'mssg': 'message_passing_steps'}
for _field in dataclasses.fields(presets.TrainConfig):
    if _field.name in ('preset', 'model', 'adjacency', 'message_passing_steps'):
        continue
    _define = {int: flags.DEFINE_integer, float: flags.DEFINE_float, bool: flags.DEFINE_bool}[
        _field.type
    ]
    _define(_field.name, None, f"Overrides the preset's {_field.name}; see TrainConfig.")
    _FIELD_FLAGS[_field.name] = _field.name
flags.DEFINE_integer('mssg', None, "Message-passing steps M; overrides the preset's.")


def _overrides() -> dict:
    """Config fields that the command line gives."""
    given = {field: flags.FLAGS[flag].value for flag, field in _FIELD_FLAGS.items()}
    given |= {'model': _MODEL.value, 'adjacency': _ADJACENCY.value}
    return {k: v for k, v in given.items() if v is not None}


def _load(overrides):
    """The class of its trainer, the evaluator, the model, the metadata, the runs of the split."""
    paths = (_MODEL_PATH.value, _DATA_PATH.value)
    stored = checkpoints.read_config(_MODEL_PATH.value).get('config')
    if isinstance(stored, dict) and stored.get('model') == 'full_space':
        model, metadata, groups = particles.load_for_evaluation(
            *paths, _RAW_PATH.value, _EVAL_SPLIT.value, overrides
        )
        return ParticleTrainer, ParticleEvaluator(model, metadata), model, metadata, groups
    _refuse_raw_path()
    model, metadata, groups = experiment.load_for_evaluation(*paths, _EVAL_SPLIT.value, overrides)
    evaluator = evaluation.Evaluator(model, metadata, _RIGID_CORRECTION.value)
    return Trainer, evaluator, model, metadata, groups


def _refuse_raw_path():
    if _RAW_PATH.value:
        raise ValueError('--raw_path is for --model=full_space only; other models take records')


def _train(overrides):
    preset = _PRESET.value or presets.preset_of_model(_MODEL.value)
    config = presets.make_config(preset, **overrides)
    rest = (
        _MODEL_PATH.value,
        config,
        _RIGID_MOTION.value,
        _SAVE_EVERY.value,
        _TAKE_OVER_LOCK.value,
    )
    if config.model == 'full_space':
        particles.train(_DATA_PATH.value, _RAW_PATH.value, *rest)
    else:
        _refuse_raw_path()
        experiment.train(_DATA_PATH.value, *rest)


def _evaluate_one_step(overrides):
    make_trainer, _, model, _, groups = _load(overrides)
    print(f'one-step errors on {_EVAL_SPLIT.value} of {_DATA_PATH.value}')
    for name, value in make_trainer(model, groups).one_step_errors().items():
        print(f'  {name:24s} {value:.6g}')


def _evaluate_rollouts(overrides):
    if not _OUTPUT_PATH.value:
        raise ValueError('--mode=eval_rollout needs --output_path')
    split = _EVAL_SPLIT.value
    _, evaluator, _, metadata, groups = _load(overrides)
    results, summary = evaluator.run(
        groups, split, lambda runs: tqdm.tqdm(runs, unit='run', disable=None)
    )
    written = evaluation.save_rollouts(_OUTPUT_PATH.value, split, results, summary, metadata)
    print(evaluation.table(summary))
    print(f'wrote {len(written)} files to {_OUTPUT_PATH.value}')


def main(_):
    """Runs the chosen mode; bad input ends with its message and exit code 2."""
    if _NUM_THREADS.value:
        tf.config.threading.set_intra_op_parallelism_threads(_NUM_THREADS.value)
        tf.config.threading.set_inter_op_parallelism_threads(1)
    overrides = _overrides()
    try:
        if _MODE.value == 'train':
            _train(overrides)
        elif _MODE.value == 'eval':
            _evaluate_one_step(overrides)
        else:
            _evaluate_rollouts(overrides)
    except (ValueError, OSError) as error:
        logging.debug('stack', exc_info=True)
        sys.exit(f'error: {error}')


if __name__ == '__main__':
    app.run(main)
