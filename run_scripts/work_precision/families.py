"""What the report compares: families of configurations, each a sweep of one decision.

The rows of a sweep are trained alike and shorter than the shipped models, so that a sweep fits in
an afternoon; the shipped rows are what the shipped models are, and are loaded where they exist.
"""

import dataclasses
from collections.abc import Sequence

from learning_to_simulate import presets
from learning_to_simulate.presets import TrainConfig
from learning_to_simulate.scene import RigidMotion

OTHER_METHODS = 'other methods'  # The one family that is no sweep.
BASE = ('base of the sweeps', {})
# Which of a body's particles are nodes: the lowest of one that is prescribed, else evenly many.
LOWEST_ONLY, EVENLY_THINNED = 'rigid particles', 'every k-th rigid particle'
# Family -> rows (label, what differs from the base). A row may lie in several families.
SWEEPS = {
    'latent size': [
        ('L = 16', {'latent_size': 16}),
        ('L = 32', {'latent_size': 32}),
        BASE,
        ('L = 128', {'latent_size': 128}),
    ],
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
    OTHER_METHODS: [
        ('MLP', {'preset': 'mlp'}),
        ('Motion-Mixer, SE', {'preset': 'mixer_se'}),
        ('Motion-Mixer, scSE', {'preset': 'mixer_scse'}),
    ],
}  # fmt: skip
SHIPPED = 'shipped presets'
FULL_SPACE = 'GNS on particles'
# Presets that are measured at their own training budget: preset -> (label, family).
PRESET_ROWS = {
    'fcg_original': ('fcg_original', SHIPPED),
    'pcg_thesis': ('pcg_thesis', SHIPPED),
    'pcg': ('pcg', SHIPPED),
    'full_space': (FULL_SPACE, OTHER_METHODS),
}
QUICK_SWEEPS = {
    'latent size': [SWEEPS['latent size'][0], BASE],
    LOWEST_ONLY: [BASE, SWEEPS[LOWEST_ONLY][-1]],
}
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


def rows(sweeps: dict, training: dict, scene, whole: Sequence[str], seeds: int) -> list[Row]:
    """The rows of a report.

    Args:
      sweeps: family -> [(label, overrides)], such as `SWEEPS`.
      training: fields that shorten the training of the swept rows; equal for all of them.
      scene: `Scene` of the dataset; sweeps that it does not have are left out.
      whole: presets that are measured at their own training budget, keys of `PRESET_ROWS`.
      seeds: trainings of the default preset 'pcg'.

    Raises:
      ValueError: an unknown preset or field.
    """
    found: dict[TrainConfig, Row] = {}
    prescribed = scene.rigid_motion == RigidMotion.PRESCRIBED
    unfit = EVENLY_THINNED if prescribed else LOWEST_ONLY

    def add(label, family, config, overrides):
        old = found.get(config)
        families = (family,) if old is None else (*old.families, family)
        found[config] = Row(old.label if old else label, families, config, overrides)

    for preset in whole:
        for seed in range(seeds if preset == 'pcg' else 1):
            overrides = {'seed': seed} if seed else {}
            config = presets.make_config(preset, **overrides)
            add(*PRESET_ROWS[preset], config, {'preset': preset} | overrides)
    for family, members in sweeps.items():
        if family == unfit:
            continue
        for label, changed in members:
            overrides = {'preset': 'pcg'} | training | changed
            config = presets.make_config(**overrides)
            n_modes = config.modes or scene.n_modes
            if n_modes > scene.n_modes or overrides.get('mode_edges', 0) > n_modes**2:
                continue  # There are not that many.
            add(label, family, config, overrides)
    return list(found.values())
