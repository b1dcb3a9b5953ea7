"""The simulated systems against closed forms, another integrator and conservation laws; names,
shapes and contents of the files."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nri import simulate
from nri.simulate import Charged, Springs, leapfrog, simulate_particles
from pca_tools import files
from tests.pca_tools.commands import call_command


def rng(seed=0):
    return np.random.default_rng(seed)


def test_springs_between_all_follow_the_cosine_of_the_highest_frequency_and_the_order_is_two():
    """Springs of length zero between all pairs: each object swings about the centre of all."""
    k, time = 3.0, 2.0
    start = rng().uniform(-0.4, 0.4, (1, 3, 2))
    half = start - start.mean(axis=1, keepdims=True)
    omega, errors = np.sqrt(3 * k), []
    exact = start - half + half * np.cos(omega * time), -half * omega * np.sin(omega * time)
    for n in (50, 100, 200):
        system = Springs(n_objects=3, dt=time / n, interaction_strength=k)
        assert system.highest_frequency() == pytest.approx(omega)
        found = leapfrog(system, start, 0 * start, 1.0 - np.eye(3)[None], n, n)
        errors.append(max(np.abs(f[:, 0] - e).max() for f, e in zip(found, exact, strict=True)))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    # Measured 2.002 and 2.0005.
    assert np.abs(order - 2).max() < 0.3


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (
            lambda: Springs(dt=0.1, interaction_strength=80.0),
            'highest frequency is 20: it must be below 0.1$',
        ),
        (lambda: Springs(n_objects=2, dt=2.0, interaction_strength=0.5), 'must be below 2$'),
        (lambda: Springs(dt=0.1, interaction_strength=1e20), 'unstable'),
        (lambda: Charged(dt=0.021), 'unstable'),
        (lambda: Springs(n_objects=1), 'at least 2'),
        (lambda: Springs(dt=-1.0), 'dt is -1.0'),
        (lambda: Charged(interaction_strength=float('nan')), 'nan'),
    ],
)
def test_unstable_or_senseless_settings_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_objects_without_relations_go_straight_and_bounce():
    system = Springs(dt=0.01, box_size=1.0)
    start, velocity = rng(1).uniform(-1, 1, (2, 4, 5, 2))
    position, after = leapfrog(system, start, velocity, np.zeros((4, 5, 5)), 1000, 1000)
    # Unfolding the box: the same straight line, reflected.
    free = np.abs((start + 10.0 * velocity + 1.0) % 4.0)
    free = np.where(free > 2.0, 4.0 - free, free) - 1.0
    np.testing.assert_allclose(position[:, 0], free, atol=1e-10)
    np.testing.assert_allclose(np.abs(after[:, 0]), np.abs(velocity), atol=1e-12)
    coarse = Springs(dt=1.0, box_size=1.0)
    with pytest.raises(ValueError, match='left the box'):
        leapfrog(coarse, 0 * start, velocity + 5.0, np.zeros((4, 5, 5)), 1, 1)


def test_charges_against_another_integrator():
    system = Charged(n_objects=3, dt=1e-4)
    charge = np.array([[1.0, -1.0, 1.0]])
    start = np.array([[[1.0, 0.0], [0.0, 0.8], [-1.0, -0.5]]])
    velocity = np.array([[[0.0, 0.3], [0.2, 0.0], [0.1, -0.2]]])

    def rate(_, state):
        x = state[:6].reshape(3, 2)
        force = np.zeros_like(x)
        for i in range(3):
            for j in range(3):
                if i != j:
                    r = x[i] - x[j]
                    force[i] += charge[0, i] * charge[0, j] * r / np.linalg.norm(r) ** 3
        return np.concatenate([state[6:], force.reshape(-1)])

    state = np.concatenate([start.reshape(-1), velocity.reshape(-1)])
    other = solve_ivp(rate, (0, 0.5), state, rtol=1e-11, atol=1e-12).y[:, -1]
    relations = charge[:, :, None] * charge[:, None]
    found = leapfrog(system, start, velocity, relations, 5000, 5000)
    # Measured 5e-9 and 4e-8.
    np.testing.assert_allclose(np.concatenate(found, axis=None), other, atol=1e-6)


def charges_energy(system, position, velocity, relations):
    """[S]; every pair stands twice in the sum. Inside the core the force falls linearly to zero."""
    r, core = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1), system.core_radius
    of_pair = np.where(r < core, 1.5 / core - r**2 / (2 * core**3), 1 / np.maximum(r, core))
    of_pair = of_pair * (1.0 - np.eye(system.n_objects))
    potential = system.interaction_strength * (relations * of_pair).sum((1, 2)) / 2
    return 0.5 * (velocity**2).sum((1, 2)) + potential


def test_charges_keep_their_energy_through_close_encounters():
    system = Charged(dt=1e-3)
    g = rng(3)
    relations = system.relations(g, 40)
    position, velocity = g.normal(size=(2, 40, 5, 2)) * [[[[0.7]]], [[[0.5]]]]
    positions, velocities = leapfrog(system, position, velocity, relations, 3000, 1000)
    before = charges_energy(system, position, velocity, relations)
    scale = 0.5 * (velocities**2).sum((1, 2, 3)) + np.abs(before)
    for t in range(3):
        after = charges_energy(system, positions[:, t], velocities[:, t], relations)
        # Measured 1.1e-3 of the energies that take part.
        assert (np.abs(after - before) / scale).max() < 0.01


@pytest.mark.parametrize('make', [Springs, Charged])
def test_momentum_is_kept_without_walls_and_half_of_all_relations_are(make):
    position, velocity, relations = simulate_particles(make(box_size=1e3), 10, 400, 200, rng(2))
    assert position.shape == velocity.shape == (10, 2, 5, 2) and relations.shape == (10, 5, 5)
    momentum = velocity.sum(2)
    np.testing.assert_allclose(momentum[:, 0], momentum[:, 1], atol=1e-11)
    relations = make().relations(rng(5), 2000)
    np.testing.assert_array_equal(relations, relations.transpose(0, 2, 1))
    # 20 000 fair pairs: the standard error is 0.0035.
    assert abs((relations[:, ~np.eye(5, dtype=bool)] > 0).mean() - 0.5) < 0.02


def test_files_have_kipfs_names_and_shapes(tmp_path):
    path = tmp_path / 'made'
    command = ['nri.simulate', '--system=charged', '--n_objects=3', '--num_train=7']
    command += ['--num_valid=2', '--num_test=3', '--length=500', f'--output_path={path}']
    refused = call_command(*command, '--dt=0.1')
    assert refused.returncode == 1 and refused.stderr.startswith('error: time step 0.1 is unstable')
    assert not path.exists()
    done = call_command(*command)
    assert done.returncode == 0 and '12 runs of 4 frames' in done.stdout, done.stderr
    for split, count in (('train', 7), ('valid', 2), ('test', 3)):
        for prefix in ('loc', 'vel'):
            array = np.load(path / f'{prefix}_{split}_charged3.npy', allow_pickle=False)
            assert array.shape == (count, 4, 2, 3) and array.dtype == np.float32
        edges = np.load(path / f'edges_{split}_charged3.npy', allow_pickle=False)
        assert edges.shape == (count, 3, 3) and set(np.unique(edges)) <= {-1.0, 1.0}
    assert files.read_json(str(path / 'simulation_charged3.json'))['dt'] == 0.001
    system = Charged(n_objects=3)
    for steps, message in ((500, 'holds'), (200, 'fewer than two frames')):
        with pytest.raises(ValueError, match=message):
            simulate.write_dataset(system, 'charged', {'train': 1}, steps, 100, 0, str(path))


def test_runs_are_a_function_of_seed_and_split():
    system = Springs(n_objects=2, dt=0.02)
    first, again, other, test = (
        simulate.simulate_split(system, 20, 40, 5, seed, split)['loc']
        for seed, split in ((0, 'train'), (0, 'train'), (1, 'train'), (0, 'test'))
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).all() and (first != test).all()
