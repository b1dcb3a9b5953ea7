"""Springs from soft to stiff, up to the limit of the integrator: energy, and what is still found.

Example:
  python -m reports nri_stiffness

One frame is one time step, so the stiffness k dt² says how far a spring swings between two frames;
Kipf's data have 0.001. The leapfrog is stable up to k dt² = 4 / V; beyond it the simulator refuses.
Edge accuracy is that of the encoder trained with labels for a fixed, short time at every stiffness:
what can be found, not what is found without labels. Writes docs/nri_stiffness.json and .png.
"""

import math
import os

import numpy as np
import tqdm
from absl import flags
from matplotlib.figure import Figure

from nri import data, particle_systems
from nri.config import NriConfig
from pca_tools import files
from reports import command, markdown, record

N_OBJECTS, DT, N_FRAMES = 5, 0.1, 49
STIFFNESSES = (1e-3, 1e-2, 3e-2, 0.1, 0.2, 0.4, 0.6, 0.72, 0.79, 0.8, 1.0, 10.0)
TRAIN_RUNS, TEST_RUNS = 4000, 1000


def springs_of(stiffness, box_size=5.0):
    """`Springs` with k dt² = `stiffness`, as large at all stiffnesses.

    Raises:
      ValueError: above the limit.
    """
    return particle_systems.Springs(
        n_objects=N_OBJECTS,
        dt=DT,
        interaction_strength=stiffness / DT**2,
        box_size=box_size,
        position_std=0.5,
        speed=0.5,
    )


def energy_errors(stiffness, n_steps=5000, n_run=100):
    """Drift and swing of the energy in a box without walls, as shares of the first energy.

    Returns:
      drift: largest change between the mean energies of the first and the second half;
      swing: largest deviation at any step. Near the limit the energy swings, but does not drift.
    """
    system = springs_of(stiffness, box_size=1e6)
    rng = np.random.default_rng(1)
    position, velocity, relations = particle_systems.simulate_particles(
        system, n_run, n_steps, 1, rng
    )
    energy = np.stack(
        [system.energy(position[:, t], velocity[:, t], relations) for t in range(n_steps)]
    )
    first, second = energy[: n_steps // 2].mean(0), energy[n_steps // 2 :].mean(0)
    return float(np.abs(second / first - 1).max()), float(np.abs(energy / energy[0] - 1).max())


def _runs(stiffness, n_run, seed):
    position, velocity, relations = particle_systems.simulate_particles(
        springs_of(stiffness), n_run, N_FRAMES, 1, np.random.default_rng(seed)
    )
    features = np.concatenate([position, velocity], axis=-1).transpose(0, 2, 1, 3)
    return data.NriData(
        features.astype(np.float32), data.edge_types(relations),
        tuple(f'node_{i}' for i in range(N_OBJECTS)), ((0, 1), (2, 3)), True,
        f'stiffness {stiffness}', f'springs with k dt² = {stiffness}',
    )  # fmt: skip


def accuracy(stiffness, epochs):
    """Edge accuracy on new runs of the encoder trained with labels."""
    from nri.model import NriModel
    from nri.training import Trainer

    train = _runs(stiffness, TRAIN_RUNS, 2)
    config = NriConfig(
        hidden=64, batch_size=64, learning_rate=2e-3, epochs=epochs, decay_start=epochs // 2,
        decay_epochs=max(epochs // 8, 1), supervised=True,
    )  # fmt: skip
    trainer = Trainer(
        NriModel(config, train.node_names, *data.normalization(train), train.digest), train
    )
    for i in range(trainer.total_steps):
        trainer.step(i)
    return trainer.evaluate(_runs(stiffness, TEST_RUNS, 3))['accuracy']


def measure(epochs):
    """A row for every stiffness; those above the limit hold the simulator's refusal."""
    rows = []
    for stiffness in tqdm.tqdm(STIFFNESSES, unit='stiffness', disable=None):
        row = {'k_dt2': stiffness, 'omega_dt_max': math.sqrt(stiffness * N_OBJECTS)}
        try:
            row['energy_drift'], row['energy_swing'] = energy_errors(stiffness)
            row['accuracy'] = accuracy(stiffness, epochs)
        except ValueError as error:
            row['refused'] = str(error)
        rows.append(row)
    return rows


def table(rows):
    """The rows as Markdown."""
    header = ('k dt²', 'largest omega dt', 'energy drift', 'energy swing', 'edge accuracy')
    return markdown.table(
        header,
        [
            (f'{row["k_dt2"]:g}', row['omega_dt_max'], 'refused')
            if 'refused' in row
            else (
                f'{row["k_dt2"]:g}', row['omega_dt_max'], f'{row["energy_drift"]:.1e}',
                f'{row["energy_swing"]:.2g}', f'{row["accuracy"]:.1%}',
            )
            for row in rows
        ],
    )  # fmt: skip


def of_file(path: str) -> str:
    """The rows of a stored result."""
    return table(files.read_json(path)['rows'])


def draw(rows, path):
    """Accuracy and energy drift against stiffness, with the limit."""
    held = [row for row in rows if 'refused' not in row]
    stiffness = [row['k_dt2'] for row in held]
    figure = Figure(figsize=(6, 5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    above.semilogx(stiffness, [row['accuracy'] for row in held], 'o-')
    above.set_ylabel('edge accuracy (with labels)')
    below.loglog(stiffness, [row['energy_drift'] for row in held], 'o-', label='drift')
    below.loglog(stiffness, [row['energy_swing'] for row in held], 's--', label='swing')
    below.set_ylabel('share of the energy')
    below.set_xlabel('stiffness k dt²')
    below.legend()
    for axes in (above, below):
        axes.axvspan(4 / N_OBJECTS, STIFFNESSES[-1], color='0.85')
    above.text(0.97, 0.1, 'refused', ha='right', transform=above.transAxes)
    files.write_atomically(path, lambda temporary: figure.savefig(temporary, format='png', dpi=120))


def define_flags():
    """Defines the command line."""
    flags.DEFINE_integer('epochs', 30, 'Epochs of each encoder.', 1)
    flags.DEFINE_string('output_path', 'docs', 'Folder for the JSON file and the picture.')


def main(given, _) -> None:
    """Measures, prints the table, writes."""
    os.makedirs(given.output_path, exist_ok=True)
    rows = measure(given.epochs)
    result = record.provenance() | {
        'objects': N_OBJECTS,
        'limit_k_dt2': 4 / N_OBJECTS,
        'training': f'with labels, {TRAIN_RUNS} runs, {given.epochs} epochs',
        'rows': rows,
    }
    stem = os.path.join(given.output_path, 'nri_stiffness')
    files.write_json(f'{stem}.json', result)
    draw(rows, f'{stem}.png')
    print(table(rows))
    print(f'wrote {stem}.json and .png')


if __name__ == '__main__':
    command.start(define_flags, main)
