"""What the report compares: families of configurations, each a sweep of one decision.

The shipped presets, their widths and the other methods are trained as long as their presets say,
and loaded where such a model exists. The rows of a sweep are trained alike and shorter, so that
all of them fit in an afternoon.
"""

import dataclasses

from learning_to_simulate import presets
from learning_to_simulate.config import TrainConfig
from learning_to_simulate.scene import RigidMotion

SHIPPED = 'shipped presets'
LATENT_SIZE = 'latent size'
OTHER_METHODS = 'other methods'
DECISIONS = 'decisions'
# Family -> rows (label, what they are) with the training of their preset.
WHOLE: dict[str, list[tuple[str, dict]]] = {
    SHIPPED: [
        ('fcg_original', {'preset': 'fcg_original'}),
        ('pcg_thesis', {'preset': 'pcg_thesis'}),
        ('pcg', {'preset': 'pcg'}),
    ],
    LATENT_SIZE: [
        ('pcg, L = 16', {'preset': 'pcg', 'latent_size': 16}),
        ('pcg, L = 32', {'preset': 'pcg', 'latent_size': 32}),
        ('pcg', {'preset': 'pcg'}),
        ('pcg, L = 128', {'preset': 'pcg', 'latent_size': 128}),
    ],
    OTHER_METHODS: [
        ('MLP', {'preset': 'mlp'}),
        ('Motion-Mixer, SE', {'preset': 'mixer_se'}),
        ('Motion-Mixer, scSE', {'preset': 'mixer_scse'}),
        ('GNS on particles', {'preset': 'full_space'}),
    ],
}
# Only where it is asked for: what the decisions behind the default are worth, one at a time.
ON_DEMAND: dict[str, list[tuple[str, dict]]] = {
    DECISIONS: [
        ('pcg', {'preset': 'pcg'}),
        ('single-step training only', {'preset': 'pcg', 'unroll_steps': 0}),
        ('accelerations instead of displacements', {
            'preset': 'pcg', 'mode_order': 2, 'rigid_order': 2, 'rate_scaled': False,
            'velocity_inputs': 5,
        }),
        ('displacements per frame, not per body displacement', {
            'preset': 'pcg', 'rate_scaled': False,
        }),
        ('five last velocities as inputs', {'preset': 'pcg', 'velocity_inputs': 5}),
        ('all rigid particles', {'preset': 'pcg', 'rigid_particles': 0}),
        ('five lowest rigid particles', {'preset': 'pcg', 'rigid_particles': 5}),
        ('published inputs (no conditioning)', {
            'preset': 'pcg', 'conditioned': False, 'rate_scaled': False, 'velocity_inputs': 5,
            'rigid_particles': 0,
        }),
    ],
}  # fmt: skip
# Presets that one training has to do for: they are references, and slow to train.
ONE_SEED = ('fcg_original', 'pcg_thesis', 'full_space')
BASE: tuple[str, dict] = ('base of the sweeps', {})
# Which of a body's particles are nodes: the lowest of one that is prescribed, else evenly many.
LOWEST_ONLY, EVENLY_THINNED = 'rigid particles', 'every k-th rigid particle'
# Family -> rows (label, what differs from the base). A row may lie in several families.
SWEEPS: dict[str, list[tuple[str, dict]]] = {
    LOWEST_ONLY: [
        ('all rigid particles', {'rigid_particles': 0}),
        ('12 rigid particles', {'rigid_particles': 12}),
        BASE,
        ('6 rigid particles', {'rigid_particles': 6}),
        ('4 rigid particles', {'rigid_particles': 4}),
        ('1 rigid particle', {'rigid_particles': 1}),
    ],
    EVENLY_THINNED: [
        BASE,
        ('every 2nd rigid particle', {'rigid_stride': 2}),
        ('every 4th rigid particle', {'rigid_stride': 4}),
    ],
    'modes': [
        BASE,
        ('6 modes', {'modes': 6, 'adjacency': 'correlation'}),
        ('4 modes', {'modes': 4, 'adjacency': 'correlation', 'mode_edges': 16}),
    ],
    'message passing': [
        BASE,
        ('M = 2', {'message_passing_steps': 2}),
        ('M = 4', {'message_passing_steps': 4}),
    ],
    'edges': [
        ('fully connected', {'adjacency': 'fully_connected'}),
        ('64 mode edges', {'adjacency': 'correlation', 'mode_edges': 64}),
        BASE,
        ('16 mode edges', {'adjacency': 'correlation', 'mode_edges': 16}),
        ('self-edges only', {'adjacency': 'correlation', 'mode_edges': 8}),
    ],
}  # fmt: skip
QUICK_WHOLE = {SHIPPED: WHOLE[SHIPPED]}  # They ship, so nothing is trained.
QUICK_SWEEPS = {LOWEST_ONLY: [BASE, SWEEPS[LOWEST_ONLY][-1]], 'modes': SWEEPS['modes'][:2]}
REFERENCE = 'reference'


@dataclasses.dataclass(frozen=True)
class Row:
    """One configuration to measure.

    Attributes:
      label: short name.
      families: curves it lies on.
      config: what it is and how it is trained.
      overrides: preset and changed fields, to read.
    """

    label: str
    families: tuple[str, ...]
    config: TrainConfig
    overrides: dict


def rows(
    whole: dict, sweeps: dict, training: dict, scene, seeds: int, sweep_seeds: int
) -> list[Row]:
    """The rows of a report: all of them with seed 0, then all with the next seed.

    Args:
      whole: family -> [(label, overrides)], such as `WHOLE`.
      sweeps: family -> [(label, overrides)], such as `SWEEPS`.
      training: fields that shorten the training of the swept rows; equal for all of them.
      scene: `Scene` of the dataset; sweeps that it does not have are left out.
      seeds: trainings of the rows of `whole`, other than `ONE_SEED`.
      sweep_seeds: trainings of the swept rows.

    Raises:
      ValueError: an unknown preset or field.
    """
    prescribed = scene.rigid_motion == RigidMotion.PRESCRIBED
    unfit = EVENLY_THINNED if prescribed else LOWEST_ONLY
    wanted = [
        (f, label, changed, seeds) for f, members in whole.items() for label, changed in members
    ]
    wanted += [
        (family, label, {'preset': 'pcg'} | training | changed, sweep_seeds)
        for family, members in sweeps.items() if family != unfit
        for label, changed in members
    ]  # fmt: skip
    found: dict[TrainConfig, Row] = {}
    for seed in range(max(seeds, sweep_seeds)):
        for family, label, overrides, count in wanted:
            if seed >= (1 if overrides['preset'] in ONE_SEED else count):
                continue
            config = presets.make_config(**overrides, seed=seed)
            n_modes = config.modes or scene.n_modes
            if n_modes > scene.n_modes or overrides.get('mode_edges', 0) > n_modes**2:
                continue  # There are not that many.
            old = found.get(config)
            families = (family,) if old is None else (*old.families, family)
            found[config] = Row(
                old.label if old else label, families, config,
                overrides | ({'seed': seed} if seed else {}),
            )  # fmt: skip
    return list(found.values())
