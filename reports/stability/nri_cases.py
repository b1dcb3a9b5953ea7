"""Springs of NRI's data up to the stability limit of the leapfrog."""

import numpy as np

from nri import particle_systems
from reports.stability.cases import REFUSED, Case, judged

PART = 'NRI springs'
N_OBJECTS, N_RUN = 5, 16
STIFFNESS = (1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.4, 0.6, 0.75, 0.8, 1.0, 10.0)  # k dt2
LIMIT = particle_systems.LEAPFROG_LIMIT**2 / N_OBJECTS


def swing_bound(stiffness):
    """Largest relative change of the leapfrog's energy at k dt2 = `stiffness`, in closed form.

    It conserves v2 / 2 + omega2 (1 - x) q2 / 2 with x = (omega dt / 2)2 <= k V dt2 / 4 exactly, so
    the energy stays between that and that over 1 - x for ever: it swings and does not drift.
    """
    x = stiffness * N_OBJECTS / 4.0
    return x / (1.0 - x)


def energy_drift(stiffness, n_steps):
    """Largest relative change of energy of any run over `n_steps`, at k dt2 = `stiffness`."""
    system = particle_systems.Springs(
        n_objects=N_OBJECTS, dt=1.0, interaction_strength=stiffness, box_size=1e9
    )
    rng = np.random.default_rng(0)
    relations = system.relations(rng, N_RUN)
    shape = (N_RUN, N_OBJECTS, 2)
    position = rng.normal(0.0, 0.5, shape)
    # Speeds of the same order as omega x displacement, so that both kinds of energy count.
    velocity = rng.normal(0.0, 0.5 * np.sqrt(stiffness), shape)
    before = system.energy(position, velocity, relations)
    positions, velocities = particle_systems.leapfrog(
        system, position, velocity, relations, n_steps, 1
    )
    after = np.array(
        [
            system.energy(positions[:, t], velocities[:, t], relations)
            for t in range(positions.shape[1])
        ]
    )
    return float(np.abs(after / before - 1.0).max())


def run_all(is_quick, progress):
    """All rows and the curve of the drift."""
    rows, curve = [], []
    n_steps = 200 if is_quick else 2000
    for stiffness in progress(STIFFNESS):
        name = f'k dt2 = {stiffness:g}: largest change of energy'
        try:
            drift = energy_drift(stiffness, n_steps)
        except ValueError as error:
            rows.append(Case(PART, name, None, '', None, REFUSED, str(error)))
            continue
        bound = swing_bound(stiffness)
        curve.append({'stiffness': stiffness, 'drift': drift, 'bound': bound})
        note = f'over {n_steps} steps of {N_RUN} runs, 5 atoms; limit of the step k dt2 = {LIMIT:g}'
        rows.append(judged(PART, name, drift, 'of the energy', bound, note))
    small = [c for c in curve if c['stiffness'] <= 0.1]
    order = np.polyfit(
        0.5 * np.log([c['stiffness'] for c in small]), np.log([c['drift'] for c in small]), 1
    )[0]
    name = 'distance of the measured order in dt from 2'
    rows.append(judged(PART, name, abs(float(order) - 2.0), '', 0.3, 'k dt2 from 1e-4 to 0.1'))
    return rows, {'springs': curve}
