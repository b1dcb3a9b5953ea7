"""The presets: the published graph networks, fully connected (FCG) and partially (PCG), this
project's PCG, and the other networks' own.

A preset is a frozen config; flags override single fields.
"""

import dataclasses
from typing import Any

from learning_to_simulate.config import GRAPH_NETWORK, FullSpaceConfig, PathRidgeConfig, TrainConfig
from learning_to_simulate.soil_field import settings as soil_field_settings

_PUBLISHED = {
    'style': 'published',
    'rigid_particles': 0,
    'velocity_inputs': 5,
    'rate_scaled': False,
    'weight_average': 0.0,
    'latent_size': 128,
    'mode_order': 2,
    'rigid_order': 2,
    'batch_size': 2,
    'unroll_steps': 0,
    'learning_rate': 1e-4,
    'learning_rate_floor': 1e-6,
    'decay_steps': 5e6,
}

# A network that takes the whole state at once: the training of `pcg` without its graph.
_WHOLE_STATE = {'adjacency': 'none', 'mode_edges': 0}

PRESETS: dict[str, Any] = {
    # Haeri & Skonieczny 2021: full graph with self-edges, dataset-wide statistics, noise 6.7e-4.
    'fcg_original': TrainConfig(
        'fcg_original',
        adjacency='fully_connected',
        noise_std=6.7e-4,
        num_steps=20_000,
        **_PUBLISHED,
    ),
    # Usmani & Skonieczny 2023: partial graph (their Algorithm 2), noise 6.7e-6.
    'pcg_thesis': TrainConfig('pcg_thesis', noise_std=6.7e-6, num_steps=20_000, **_PUBLISHED),
    # This project's default: partial graph, own inputs, displacement outputs, unrolled
    # training.
    'pcg': TrainConfig('pcg'),
    # Holden et al. 2019: a plain MLP on the subspace state.
    'mlp': TrainConfig('mlp', model='mlp', latent_size=128, **_WHOLE_STATE),
    # For free driving: where the modes are follows from what the blade has done since the start.
    # Nothing is integrated, so nothing drifts; shifted and mirrored runs stand for those that were
    # not driven.
    'mlp_driven': TrainConfig(
        'mlp_driven',
        model='mlp',
        latent_size=256,
        mode_order=0,
        rate_scaled=False,
        copies=8,
        noise_std=0.0,
        batch_size=128,
        num_steps=8000,
        unroll_steps=0,
        decay_steps=5300.0,
        **_WHOLE_STATE,
    ),
    # Bouazizi et al. 2022 with channel excitation, and with channel and frame excitation.
    'mixer_se': TrainConfig(
        'mixer_se', model='mixer_se', velocity_inputs=5, hidden_layers=1, **_WHOLE_STATE
    ),
    'mixer_scse': TrainConfig(
        'mixer_scse', model='mixer_scse', velocity_inputs=5, hidden_layers=1, **_WHOLE_STATE
    ),
    # Sanchez-Gonzalez et al. 2020 on thinned particles; small, because every step costs a KD-tree
    # and thousands of edges. Displacements per displacement of the body, and noise of twice the
    # spread of the one velocity that is an input: with accelerations, five velocities and little
    # noise it learns to go on as before, so that soil which rests rests for ever.
    'full_space': FullSpaceConfig(
        'full_space',
        noise_std=2.0,
        latent_size=32,
        message_passing_steps=3,
        batch_size=2,
        decay_steps=2500.0,
    ),
    **soil_field_settings.PRESETS,
    # A baseline without dynamics: regression on the path.
    'path_ridge': PathRidgeConfig('path_ridge'),
    'path_ridge_few_runs': PathRidgeConfig(
        'path_ridge_few_runs', max_samples=1500, leave_one_out=True
    ),
}


def preset_of_model(model: str | None) -> str:
    """The preset that is meant where only a model is named: `pcg` for gns or none, else that of
    its name; ValueError for an unknown one."""
    name = 'pcg' if model in (None, GRAPH_NETWORK) else model
    if name not in PRESETS or PRESETS[name].model != (model or GRAPH_NETWORK):
        models = dict.fromkeys(preset.model for preset in PRESETS.values())
        raise ValueError(f'unknown model {model!r}; there are {", ".join(models)}')
    return name


def setting_types() -> dict[str, type]:
    """Name of a setting -> its type, of all methods: names that are shared are of one type."""
    classes = dict.fromkeys(map(type, PRESETS.values()))
    return {f.name: f.type for kind in classes for f in dataclasses.fields(kind)}  # type: ignore[misc]


def make_config(preset: str, **overrides):
    """The settings of a preset with single fields replaced; None means 'not given'. ValueError for
    an unknown preset, model or field, a model that the preset is none of, or a value outside its
    range."""
    if preset not in PRESETS:
        raise ValueError(f'unknown preset {preset!r}; there are {", ".join(PRESETS)}')
    fields = {f.name for f in dataclasses.fields(PRESETS[preset])}
    if unknown := set(overrides) - fields:
        raise ValueError(
            f'preset {preset!r} has no settings {sorted(unknown)}; '
            f'it has {", ".join(sorted(fields))}'
        )
    model = overrides.get('model')
    if model is not None and type(PRESETS[preset_of_model(model)]) is not type(PRESETS[preset]):
        raise ValueError(f'preset {preset!r} is one of {PRESETS[preset].model!r}, not of {model!r}')
    given = {k: v for k, v in overrides.items() if v is not None}
    whole = PRESETS[preset]
    if 'num_steps' in given and 'unroll_steps' in fields - given.keys():
        # A shorter or longer training has both stages in the proportion of the preset.
        given['unroll_steps'] = round(given['num_steps'] * whole.unroll_steps / whole.num_steps)
    return dataclasses.replace(whole, **given)
