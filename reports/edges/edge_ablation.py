"""What the edges between modes are worth: one simulator, one budget, many edge lists.

Examples:
    # the graphs of NRI first (a list for each seed), then the comparison
    python -m reports nri_stability --data_path=datasets/excavation --work_path=/tmp/nri \\
        --output_path=docs/edges/excavation_nri.json
    python -m reports edges --data_path=datasets/excavation \\
        --nri_path=docs/edges/excavation_nri.json --output_path=docs/edges/excavation.json

    # two rows with the budget of the shipped models
    python -m reports edges --data_path=datasets/excavation --num_steps=3000 \\
        --unroll_steps=2000 --unroll_length=16 --unroll_batch_size=8 \\
        --variants='none,correlation and self-edges' --output_path=docs/edges/excavation_long.json

    # the table and the picture again, from the JSON alone
    python -m reports edges --output_path=docs/edges/excavation.json --report_only

    # the list of one variant (of the seed that was best on valid) as the dataset's own
    python -m reports edges --output_path=docs/edges/excavation.json --report_only \\
        --variant='learned gates' --edges_path=datasets/excavation/edges.json

Every row is the `pcg` preset with fewer steps. Rows of one seed differ in their edges alone: same
first weights, batches and noise. They share one compiled training step, in which the messages of
edges that a list lacks are multiplied by 0 (a test holds that against the graph without them);
errors and times are those of the graph without them. Finished rows are kept in the JSON, so the
same command goes on where it was stopped.
"""

import os
import time
from functools import partial

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import connectivity_utils, presets, reading_utils
from learning_to_simulate.subspace import edge_lists
from pca_tools import dataset, files
from reports import command, record, timing
from reports.edges import edge_ablation_report

FULL, GATES, NRI = 'fully connected', 'learned gates', 'NRI'
RANDOM_DRAWS = 5
PCG = presets.PRESETS['pcg']


def edge_lists_of(velocities, keep: int, seed: int, nri_rows) -> dict:
    """The mode block of every variant for one seed, and what it was chosen by.

    Lists of a number of edges have no self-edges: NRI has none, and so the lists differ in their
    choice of pairs alone.

    Args:
      velocities: float [S, T, r, D] of the modes on the training runs.
      keep: number of edges of the lists that have a number.
      seed: of the simulator; NRI's list is that of its own training from the same seed.
      nri_rows: `seeds` of the JSON of `nri_stability`, or None.

    Returns:
      variant -> (mask, scores): bool [r, r], None where training finds it; float [r, r] in
      [0, 1], None where nothing was ranked.

    Raises:
      ValueError: if NRI's nodes are not the modes, or it has no training from that seed.
    """
    r = velocities.shape[2]
    nobody, own = np.zeros((r, r), bool), np.eye(r, dtype=bool)
    correlation = connectivity_utils.mode_correlations(velocities)
    np.fill_diagonal(correlation, np.nan)

    def kept(scores):
        return edge_lists.select(scores, keep=keep, self_edges=False)

    masks = {
        'none': (nobody, None),
        'self-edges only': (own, None),
        'all modes': (~nobody, None),
        'correlation': (kept(correlation), correlation),
        'correlation and self-edges': (kept(correlation) | own, correlation),
        GATES: (None, None),
    }
    if nri_rows is not None:
        row = next((row for row in nri_rows if row['seed'] == seed), None)
        if row is None or row['node_names'] != list(edge_lists.mode_names(r)):
            raise ValueError(f'NRI has no training over {r} modes from seed {seed}')
        probabilities = np.array(row['probabilities'], np.float64)
        masks[NRI] = kept(probabilities), probabilities
    if seed == 0:
        for draw in range(RANDOM_DRAWS):
            score = np.random.default_rng([draw, r]).random((r, r))
            np.fill_diagonal(score, np.nan)
            masks[f'random {draw + 1}'] = kept(score), None
    return masks


class Bench:
    """Trains one simulator again and again on other edges, without compiling it again.

    Args:
      data_path: dataset folder.
      config: `TrainConfig`; with a gate weight, the graph has all mode edges and any can be shut.
    """

    def __init__(self, data_path: str, config):
        import tensorflow as tf

        from learning_to_simulate.subspace import method
        from learning_to_simulate.subspace.trainer import Trainer

        self.config, self._data_path = config, data_path
        self._metadata = dataset.read_metadata(data_path)
        self._groups = self._read('train')
        self.model = method.make_model(data_path, self._metadata, self._groups, config)
        self._layouts = {}
        if config.gate_weight:
            for group in self._groups:
                layout = self.model.layout(group.n_rigid)
                layout.edge_gates = tf.Variable(tf.ones([1, layout.n_edge]))
                self._layouts[group.n_rigid] = layout
        self._trainer = Trainer(self.model, self._groups)
        self._gates = self._trainer.gates
        t = self._trainer
        variables = t.simulator.trainable_variables
        self._state = [*variables, *t.optimizer.variables, *t.averaging.variables]
        if self._gates:
            self._state += [self._gates.log_alpha, *self._gates.optimizer.variables]
        self._start = [v.numpy() for v in self._state]

    def _read(self, split):
        return reading_utils.read_groups(
            self._data_path, split, self._metadata, self.config.rigid_particles
        )

    def _use(self, mask):
        """Shuts the mode edges that a mask lacks."""
        for n_rigid, layout in self._layouts.items():
            whole = np.ones((layout.n_node, layout.n_node), np.float32)
            whole[n_rigid:, n_rigid:] = mask
            layout.edge_gates.assign(whole[layout.receivers, layout.senders][None])

    def train(self, mask, scores=None, progress=iter) -> dict:
        """Trains from the first weights and rolls out valid and test.

        Args:
          mask: bool [r, r]; None learns it by gates, or leaves a fully connected graph as it is.
          scores: float [r, r] that the mask was chosen by, for the record; None if there are none.
          progress: wraps the iterable of steps.

        Returns:
          the row: edges, mask, errors on both splits, seconds of one core.
        """
        from learning_to_simulate import evaluation

        clock, trainer = time.process_time(), self._trainer
        for variable, value in zip(self._state, self._start):
            variable.assign(value)
        learns = self._gates is not None and mask is None
        trainer.gates = self._gates if learns else None
        if mask is not None:
            self._use(mask)
        for step in progress(range(trainer.total_steps)):
            if learns and self._gates and step == self.config.gate_steps:
                learned = self._gates.edge_list(self.config, self._data_path)
                mask, scores = learned.mask, learned.probabilities
                self._use(mask)
            values = trainer.step(step)
        if not np.isfinite(float(values['loss'])):
            raise ValueError(f'loss is {float(values["loss"])} after {step + 1} steps')
        row = {
            'mask': None if mask is None else mask.astype(int).tolist(),
            'scores': None
            if scores is None
            else [[None if np.isnan(x) else round(float(x), 6) for x in line] for line in scores],
        }
        if mask is not None:
            self.model.fix_mode_edges(mask)
        evaluator = evaluation.Evaluator(self.model, self._metadata)
        with trainer.averaging.in_place():
            for split in ('valid', 'test'):
                _, summary = evaluator.run(self._read(split), split)
                mean = summary['mean']['model']
                row[split] = {
                    'soil_mse': mean['soil_mse'],
                    'of_best_trivial': summary['soil_mse_over_best_trivial'],
                    'force_relative_l2': mean.get('force_relative_l2'),
                }
        return row | {
            'edges': self.model.layout(self._groups[0].n_rigid).n_edge,
            'mode_edges': None if mask is None else int(mask.sum()),
            'self_edges': None if mask is None else int(mask.diagonal().sum()),
            'cpu_seconds': time.process_time() - clock,
        }


def time_steps(data_path: str, masks: dict, rounds: int) -> dict:
    """Milliseconds per step of a rollout of one run, all graphs warmed up and then in turns.

    Args:
      data_path: dataset folder.
      masks: variant -> bool [r, r], or None for the fully connected graph.
      rounds: rollouts of each; of fresh models, as weights do not change the time.

    Returns:
      variant -> dict of `ms_min`, `ms_median`, `ms_p95`, `ms_p99`, `ms_worst` and `edges`.
    """
    from learning_to_simulate.compiled.folded_step import rollout_function
    from learning_to_simulate.rollout import rollout_inputs
    from learning_to_simulate.subspace import method

    metadata = dataset.read_metadata(data_path)
    groups, runs = (
        reading_utils.read_groups(data_path, split, metadata, PCG.rigid_particles)
        for split in ('train', 'test')
    )
    one = runs[0].select(0)
    jobs, edges = {}, {}
    for name, mask in masks.items():
        kind = 'fully_connected' if mask is None else 'correlation'
        config = presets.make_config('pcg', adjacency=kind, mode_edges=0)
        model = method.make_model(data_path, metadata, groups, config)
        if mask is not None:
            model.fix_mode_edges(np.array(mask, bool))
        layout = model.layout(one.n_rigid)
        function = rollout_function(model.simulator, layout)
        inputs = rollout_inputs(one, layout, model.simulator.scene)
        jobs[name] = timing.Job(partial(timing.first_output, function, inputs), inputs[-1])
        edges[name] = layout.n_edge
    times = timing.in_turns(jobs, rounds)
    return {name: found.summary('ms_') | {'edges': edges[name]} for name, found in times.items()}


def _budget(v) -> dict:
    return {
        'data': edge_lists.data_digests(v.data_path),
        'keep': v.keep,
        'gate_weight': v.gate_weight,
        'gate_steps': v.gate_steps,
        'num_steps': v.num_steps,
        'unroll_steps': v.unroll_steps,
        'unroll_length': v.unroll_length,
        'unroll_batch_size': v.unroll_batch_size,
    }


def _nri_rows(v):
    """The seeds of `nri_stability` on the same data, or None without --nri_path."""
    if not v.nri_path:
        return None
    values = files.read_json(v.nri_path)
    if not isinstance(values, dict) or 'seeds' not in values:
        raise ValueError(f'{v.nri_path}: not the result of reports nri_stability')
    if values.get('digests') != edge_lists.data_digests(v.data_path):
        raise ValueError(f'{v.nri_path}: NRI was trained on another dataset than {v.data_path}')
    return values['seeds']


def run(v) -> dict:
    """Trains what is not yet in the JSON, times all graphs, and returns the whole result."""
    import tensorflow as tf

    budget, nri_rows = _budget(v), _nri_rows(v)
    scene = os.path.basename(os.path.normpath(v.data_path))
    identity = {'scene': scene, 'budget': budget}
    result = record.resume(v.output_path, identity, {'rows': [], 'timing': {}})
    result |= record.provenance(v.num_threads)
    shared = {k: budget[k] for k in budget if k.endswith(('steps', 'length', 'batch_size'))}
    shared['num_steps'] += budget['unroll_steps']  # single ones are budgeted
    done = {(row['variant'], row['seed']) for row in result['rows']}

    def keep_row(variant, seed, row):
        result['rows'].append({'variant': variant, 'seed': seed} | row)
        files.write_json(v.output_path, result)

    metadata = dataset.read_metadata(v.data_path)
    groups = reading_utils.read_groups(v.data_path, 'train', metadata)
    velocities = np.concatenate([g.velocity[:, :, g.n_rigid :] for g in groups])
    known = {FULL, *edge_lists_of(velocities, v.keep, 0, nri_rows)}
    if unknown := set(v.variants or ()) - known:
        raise ValueError(f'unknown variants {sorted(unknown)}; there are {sorted(known)}')
    for seed in range(v.seeds):
        masks = edge_lists_of(velocities, v.keep, seed, nri_rows)
        todo = {
            name: pair
            for name, pair in masks.items()
            if (name, seed) not in done and name in (v.variants or masks)
        }
        gated = {'gate_weight': v.gate_weight}
        benches = [(todo, shared | gated)]
        if (FULL, seed) not in done and FULL in (v.variants or [FULL]):
            benches.append(({FULL: (None, None)}, shared | {'adjacency': 'fully_connected'}))
        for variants, overrides in benches:
            if not variants:
                continue
            tf.keras.backend.clear_session()
            bench = Bench(v.data_path, presets.make_config('pcg', **overrides, seed=seed))
            for name, (mask, scores) in variants.items():

                def progress(steps, text=f'seed {seed}, {name}'):
                    return tqdm.tqdm(steps, desc=text, unit='step', disable=None)

                row = bench.train(mask, scores, progress)
                keep_row(name, seed, row)
                print(
                    f'seed {seed}, {name}: {row["mode_edges"]} mode edges, valid '
                    f'{row["valid"]["of_best_trivial"]:.3g} of best trivial, '
                    f'{row["cpu_seconds"]:.0f} s',
                    flush=True,
                )
    first = {row['variant']: row['mask'] for row in reversed(result['rows']) if row['seed'] == 0}
    result['timing'] = time_steps(v.data_path, first, v.rounds)
    files.write_json(v.output_path, result)
    return result


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.')
    flags.DEFINE_string('nri_path', None, 'JSON of reports nri_stability; none: no NRI row.')
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.', required=True)
    flags.DEFINE_bool('report_only', False, 'Write the table and the picture of the JSON again.')
    flags.DEFINE_string('variant', None, 'Variant whose list is written to --edges_path.')
    flags.DEFINE_string('edges_path', None, 'edges.json to write.')
    flags.DEFINE_list('variants', None, 'Only these rows, as the table names them; none: all.')
    flags.DEFINE_integer('seeds', 3, 'Trainings of each variant; random lists have one.', 1)
    flags.DEFINE_integer('keep', 20, 'Mode edges of the lists that have a number.', 1)
    flags.DEFINE_float('gate_weight', 2.0, 'Price of the open gates.', 0.0)
    flags.DEFINE_integer('gate_steps', 600, 'Steps in which gates are learned.', 1)
    flags.DEFINE_integer('num_steps', 1000, 'Single-step training.', 2)
    flags.DEFINE_integer('unroll_steps', 150, 'Training through rollouts.', 0)
    flags.DEFINE_integer('unroll_length', 8, 'Frames of those rollouts.', 2)
    flags.DEFINE_integer('unroll_batch_size', 4, 'Rollouts in a batch.', 1)
    flags.DEFINE_integer('rounds', 20, 'Timed rollouts of each graph.', 1)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads of TensorFlow.', 1)


def main(v, _) -> None:
    """Runs the command."""
    if v.report_only:
        result = files.read_json(v.output_path)
    elif not v.data_path:
        raise ValueError('give --data_path, or --report_only')
    else:
        os.makedirs(os.path.dirname(os.path.abspath(v.output_path)), exist_ok=True)
        result = run(v)
    text = edge_ablation_report.write(result, os.path.splitext(v.output_path)[0])
    if v.variant:
        if not v.edges_path:
            raise ValueError('--variant needs --edges_path')
        edges = edge_ablation_report.edges_of(result, v.variant)
        edge_lists.write(v.edges_path, edges)
        text += f'\n\nwrote {v.edges_path}: {edges.n_edge} edges, {edges.report["source"]}'
    print(text)


if __name__ == '__main__':
    command.start(define_flags, main)
