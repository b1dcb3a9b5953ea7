"""Sweeps of the solver's own parameters: what is changed while one is run, and only then."""

import numpy as np
import pytest

from mpm import contact, experiments, packing, scenes, simulation, solver
from mpm.constitutive import make_soil
from reports import solver_sweeps


@pytest.fixture(scope='module')
def scene():
    return experiments.coarse(scenes.EXCAVATION)


def test_constants_are_changed_for_a_while():
    before = (contact.RADIUS, solver.EXCHANGE, simulation.INTERVALS)
    with solver_sweeps.changed('contact radius, spacings', 0.1):
        assert contact.RADIUS == 0.1
    with (
        pytest.raises(ZeroDivisionError),
        solver_sweeps.changed('exchanges per frame', 36),
    ):
        assert solver.EXCHANGE == simulation.EXCHANGE == 1 / 2160 and simulation.INTERVALS == 36
        raise ZeroDivisionError
    assert before == (contact.RADIUS, solver.EXCHANGE, simulation.INTERVALS)


def test_each_parameter_moves_the_force(scene):
    """Every sweep but the step's reaches the solver: forces differ from those of the solver."""
    soil = make_soil(simulation.Settings().youngs_modulus, scenes.PACKING_MU_S)
    particles = packing.settle(scene.bin, soil, 0)[0]

    def force_of(parameter, value):
        return solver_sweeps.drive(scene, 186, particles, 8, parameter, value)[0][:, 0]

    base = force_of('dilation K', 0.0)
    for parameter, values in solver_sweeps.SWEEPS.items():
        other = force_of(parameter, values[-1])
        change = np.abs(other - base).max() / np.abs(base).max()
        assert change > 0.0, parameter
        assert (change < 0.01) == (parameter in ('steps, of the fewest', 'damping, of dx / c'))


def test_table_stands_beside_the_solver_as_it_is(tmp_path, scene, monkeypatch):
    path = str(tmp_path / 'sweeps.json')
    monkeypatch.setattr(solver_sweeps, 'SWEEPS', {'dilation K': (0.0, 6.0)})

    def drive(scene, case, particles, frames, parameter, value):
        force = np.full((frames, 3), 100.0 + value)
        return force, np.full((4, 4), 1e-3 * value), 0.25, 1.5

    monkeypatch.setattr(solver_sweeps, 'drive', drive)
    made = solver_sweeps.measure(scene, 186, 5, path)
    assert [row['value'] for row in made['rows']] == [0.0, 6.0]
    assert '| dilation K | 6 | 106 | +6.00 |' in solver_sweeps.table(path)
    assert made['rows'][1]['surface_mm'] == pytest.approx(6.0)
    monkeypatch.setattr(solver_sweeps, 'drive', None)  # finished rows are not made again
    assert solver_sweeps.measure(scene, 186, 5, path)['rows'] == made['rows']
    with pytest.raises(ValueError, match='frames'):
        solver_sweeps.measure(scene, 186, 6, path)
