"""Checks that need no run of a scene."""

from mpm import experiments
from mpm.solver import EXCHANGE
from mpm.verification import incline
from mpm.verification.rows import Check, reported


def free_fall() -> list[Check]:
    """A block falls."""
    fall = experiments.free_fall()
    return [
        Check('free fall: relative error', fall['error'], 0.0, 1e-9, 'of g t2 / 2'),
        Check('free fall: change of shape', fall['deformation'], 0.0, 1e-9, 'over the fall'),
    ]


def shear() -> list[Check]:
    """One particle is sheared at constant volume."""
    rows = []
    for number in (0.01, 0.3):
        found = experiments.homogeneous_shear(number)
        ratio = found['tau_over_p'] / found['mu']
        name = f'shear at I = {number}: tau/p over mu(I)'
        rows.append(Check(name, ratio, 1.0, 0.01, 'Jop et al. 2006'))
    return rows


def momentum() -> list[Check]:
    """A blade is shot through weightless soil."""
    found = experiments.contact_momentum()
    name = 'contact: momentum not accounted for'
    return [Check(name, found['unbalanced'], 0.0, 1e-10, 'over the impulse')]


def column(aspect: float) -> list[Check]:
    """A column collapses."""
    found = experiments.column_collapse(aspect)
    return [
        Check(
            f'column collapse, a = {aspect:g}: run-out over published',
            found['runout'] / found['expected'],
            1.0,
            0.3,
            'channel, Lube et al. 2005',
        )
    ]


RESTING_DEG = {'beads': 19.0, "the blade's soil": 36.0}  # static: 20.9 and 37.2
DENSE = 8.0  # particles a cell


def incline_flow() -> list[Check]:
    """Beads flow down an incline, densely sampled and as the scenes are."""
    rows = []
    for per_cell in (2.0, DENSE):
        (found,) = incline.bagnold(per_cell, (2.0, 4.0))
        name = f'incline, beads at {incline.FLOWING_DEG:g} degrees'
        note = f'2 to 4 s, {per_cell:g} particles a cell'
        rows += [
            Check(f'{name}: profile, RMS over surface speed', found['profile'], 0.0, 0.05,
                  f'{note}, GDR MiDi 2004'),
            Check(f'{name}: surface speed over closed form', found['surface'], 1.0, 0.05, note),
            Check(f'{name}: depth over that before', found['depth'], 1.0, 0.05, note),
        ]  # fmt: skip
    return rows


def incline_exchange() -> list[Check]:
    """What the interval of the exchange does to that flow."""
    rows = []
    for factor in (0.5, 2.0):
        (found,) = incline.bagnold(DENSE, (2.0, 4.0), exchange=factor * EXCHANGE)
        name = f'incline, beads: exchange interval x {factor:g}'
        rows += [
            reported(f'{name}, surface speed over closed form', found['surface'], '2 to 4 s'),
            reported(f'{name}, profile, RMS over surface speed', found['profile'], '2 to 4 s'),
        ]
    return rows


def incline_halt() -> list[Check]:
    """Below the static angle a layer comes to rest."""
    rows = []
    for name, soil in (('beads', incline.beads()), ("the blade's soil", incline.soil_of_blade())):
        speed = incline.halt(soil, RESTING_DEG[name], 2.0)
        title = f'incline, {name} at {RESTING_DEG[name]:g} degrees: mean speed after 3 s, mm/s'
        note = f'0.1 m/s at first; C = {incline.posedness(soil, 0.01):.2f} at I = 0.01'
        rows.append(Check(title, 1e3 * speed, 0.0, 1.0, note))
    return rows
