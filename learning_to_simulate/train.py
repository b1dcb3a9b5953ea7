"""Trains and evaluates models of all methods.

Examples:
  # train the default model on a dataset folder, resume by giving the same command again
  lts train --data_path=datasets/excavation --model_path=/tmp/pcg

  # roll out the test split: rollout_test_*.npz and metrics.json
  lts evaluate --data_path=datasets/excavation --model_path=/tmp/pcg --output_path=/tmp/rollouts

  # one-step errors on the validation split
  lts train --mode=eval --eval_split=valid --data_path=... --model_path=...

  # other networks on the same state: an MLP, a Motion-Mixer with SE or scSE
  lts train --model=mlp --data_path=... --model_path=...

  # published baselines, a loaded edge list, the authors' wheel with its measured motion
  lts train --preset=fcg_original --data_path=... --model_path=...
  lts train --adjacency=edges.json --data_path=... --model_path=...
  lts train --rigid_motion=driven --data_path=Wheel_PCA --model_path=...

  # a tool anywhere on a terrain, from several datasets with height maps
  lts train --model=soil_field --data_path=datasets/excavation,datasets/excavation_wide ...

  # a setting without a flag of its own, by name; or all of them from a file
  lts train --set=hidden_layers=3 --data_path=... --model_path=...
  lts train --config=settings.json --data_path=... --model_path=...

Settings that are not given take the preset's value; in the other modes they are read from the
model, and one that contradicts them is refused.
"""

import os

import tqdm
from absl import flags

from learning_to_simulate import checkpoints, command, presets, registry, shipped
from pca_tools import files

flags.DEFINE_enum(
    'mode', 'train', ['train', 'eval', 'eval_rollout'], 'Train, or evaluate a trained model.'
)
_EVAL_SPLIT = flags.DEFINE_enum(
    'eval_split', 'test', ['train', 'valid', 'test'], 'Split to evaluate on.'
)
_DATA_PATH = flags.DEFINE_string(
    'data_path',
    None,
    'Dataset folder (metadata.json, *.tfrecord); of a soil field several, separated by commas.',
    required=True,
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
_RIGID_MOTION = flags.DEFINE_string(
    'rigid_motion',
    None,
    "Overrides the scene's: prescribed, driven (height predicted) or predicted.",
)
_SAVE_EVERY = flags.DEFINE_integer(
    'save_every', None, 'Steps between checkpoints; default: a tenth of all, 100 at least.', 1
)
_INITIAL_WEIGHTS = flags.DEFINE_string(
    'initial_weights', None, 'Soil field (folder, or a shipped one) that a soil field starts from.'
)
_NUM_PROCESSES = flags.DEFINE_integer(
    'num_processes',
    min(os.cpu_count() or 1, 8),
    'Processes that make the samples of a soil field.',
    1,
)
flags.DEFINE_integer('num_threads', None, 'CPU threads of TensorFlow; default: its own choice.', 1)

# Settings of the model.
_PRESET = flags.DEFINE_string(
    'preset', None, f'One of {", ".join(presets.PRESETS)}; default: the one of --model, else pcg.'
)
_CONFIG = flags.DEFINE_string(
    'config', None, 'JSON file of settings {name: value}, or the config.json of a model.'
)
_SET = flags.DEFINE_multi_string(
    'set',
    [],
    'NAME=VALUE of any setting; may be given again. config.py says what each means: '
    + ', '.join(f'{name} ({kind.__name__})' for name, kind in presets.setting_types().items()),
)
# Those that are set often have a flag of their name.
_OFTEN_SET = {
    'model': "Method; overrides the preset's: "
    + '; '.join(f'{name}, {method.about}' for name, method in registry.METHODS.items()),
    'adjacency': 'Edges: edges.json, mask.npy, fully_connected, algorithm2, correlation, random '
    'or none.',
    'mode_edges': 'Number of edges between modes, the best ranked ones.',
    'gate_weight': 'Above 0, edges are learned; weight of their number in the loss.',
    'modes': 'Number of first modes that become nodes; 0: all.',
    'rigid_particles': 'Number of particles of a blade that become nodes, lowest first.',
    'latent_size': 'Width of the network.',
    'members': 'Networks of a soil field that are averaged.',
    'num_steps': 'Training steps in all; of a soil field, those of its load.',
    'batch_size': 'Windows in a batch.',
    'noise_std': 'Random-walk noise of the last input step.',
    'seed': 'Seed of weights, batches and noise.',
}
_DEFINE = {str: flags.DEFINE_string, int: flags.DEFINE_integer, float: flags.DEFINE_float}
_FLAGS = [
    _DEFINE[presets.setting_types()[name]](name, None, text) for name, text in _OFTEN_SET.items()
]


def _overrides() -> dict:
    """Settings that the command line gives: by a file, by --set, by a flag of their own; ValueError
    for one that does not exist, is given twice, or is of another type."""
    found = {}
    if _CONFIG.value:
        values = files.read_json(_CONFIG.value)
        values = values.get('config', values) if isinstance(values, dict) else None
        if not isinstance(values, dict) or not values.keys() <= presets.setting_types().keys():
            raise ValueError(f'{_CONFIG.value}: not a JSON object of settings {{name: value}}')
        found = values
    given = command.settings(_SET.value, presets.setting_types())
    for flag in _FLAGS:
        if flag.value is not None:
            if flag.name in given:
                raise ValueError(f'{flag.name} is given by --{flag.name} and by --set')
            given[flag.name] = flag.value
    found |= given
    if _PRESET.value:
        found['preset'] = _PRESET.value
    return found


def _open(overrides) -> registry.OpenedModel:
    if _RIGID_MOTION.value is not None:
        overrides = overrides | {'rigid_motion': _RIGID_MOTION.value}
    return registry.open_model(
        _MODEL_PATH.value, _DATA_PATH.value, _EVAL_SPLIT.value, overrides, raw_path=_RAW_PATH.value
    )


def _evaluate_one_step(overrides):
    opened = _open(overrides)
    print(f'one-step errors on {_EVAL_SPLIT.value} of {_DATA_PATH.value}')
    for name, value in opened.one_step_errors().items():
        print(f'  {name:24s} {value:.6g}')


def _evaluate_rollouts(overrides):
    from learning_to_simulate import evaluation  # loads TensorFlow

    split = _EVAL_SPLIT.value
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
    """Runs the chosen mode. Bad settings are refused before TensorFlow is loaded."""
    overrides = _overrides()
    if values.mode == 'train':
        preset = overrides.pop('preset', None) or presets.preset_of_model(overrides.get('model'))
        config = presets.make_config(preset, **overrides)
    elif values.mode == 'eval_rollout':
        if not _OUTPUT_PATH.value:
            raise ValueError('--mode=eval_rollout needs --output_path')
        command.writable_folder(_OUTPUT_PATH.value)
    command.import_tensorflow(values.num_threads)
    if values.mode == 'train':
        first = _INITIAL_WEIGHTS.value
        registry.train(
            _DATA_PATH.value,
            _MODEL_PATH.value,
            config,
            rigid_motion=_RIGID_MOTION.value,
            save_every=_SAVE_EVERY.value,
            num_processes=_NUM_PROCESSES.value,
            raw_path=_RAW_PATH.value,
            initial_weights=first and shipped.find(first, 'models'),
        )
    elif values.mode == 'eval':
        _evaluate_one_step(overrides)
    else:
        _evaluate_rollouts(overrides)


if __name__ == '__main__':
    command.start(run)
