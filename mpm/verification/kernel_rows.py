"""Checks that need no run of a scene."""

from mpm import experiments
from mpm.constitutive import DILATION
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
    for number, is_nonlocal in ((0.01, False), (0.3, False), (0.01, True)):
        found = experiments.homogeneous_shear(number, is_nonlocal=is_nonlocal)
        law, source = 'mu(I)', 'Jop et al. 2006'
        if is_nonlocal:
            law, source = 'steady nonlocal mu', 'mu_s + (mu_2 - mu_s) I / I0'
        ratio = found['tau_over_p'] / found['mu']
        rows.append(Check(f'shear at I = {number}: tau/p over {law}', ratio, 1.0, 0.01, source))
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


SCENE_CELLS = 15  # a period that holds the packing of the excavation exactly
RESTING_DEG = {'beads': 19.0, "the blade's soil": 36.0}  # static: 20.9 and 37.2


def _packed(denser: int, cells: int = 4) -> str:
    return f'{incline.particles_per_cell(denser, cells):.2g} particles a cell'


def incline_flow() -> list[Check]:
    """Beads flow down an incline, densely sampled."""
    early, late = incline.bagnold(4, (2.0, 4.0, 8.0))
    (rest,) = incline.bagnold(4, (4.0, 8.0), share=0.0)
    name, packed = f'incline, beads at {incline.FLOWING_DEG:g} degrees', _packed(4)
    speed = f'{name}: surface speed over closed form'
    return [
        Check(f'{name}: profile, RMS over surface speed', early['profile'], 0.0, 0.05,
              f'2 to 4 s, GDR MiDi 2004, {packed}'),
        Check(speed, early['surface'], 1.0, 0.05, f'2 to 4 s, {packed}'),
        Check(speed, late['surface'], 1.0, 0.05, f'4 to 8 s, {packed}'),
        Check(speed, rest['surface'], 1.0, 0.05, f'4 to 8 s, from rest, {packed}'),
    ]  # fmt: skip


def incline_exchange() -> list[Check]:
    """What the interval of the exchange does to that flow."""
    rows = []
    for factor in (0.5, 2.0):
        (found,) = incline.bagnold(4, (2.0, 4.0), exchange=factor * EXCHANGE)
        name = f'incline, beads: exchange interval x {factor:g}'
        rows += [
            reported(f'{name}, surface speed over closed form', found['surface'], '2 to 4 s'),
            reported(f'{name}, profile, RMS over surface speed', found['profile'], '2 to 4 s'),
        ]
    return rows


def incline_packing() -> list[Check]:
    """What the number of particles does to that flow: does the layer keep its volume?"""
    rows = []
    for denser, cells in ((1, SCENE_CELLS), (2, 4), (3, 4)):
        (found,) = incline.bagnold(denser, (2.0, 4.0), cells=cells)
        name, note = 'incline, beads', f'2 to 4 s, {_packed(denser, cells)}'
        rows.append(Check(f'{name}: depth over that before', found['depth'], 1.0, 0.05, note))
        if denser > 1:  # else no soil is left where the surface was
            speed = f'{name}: surface speed over closed form'
            rows.append(reported(speed, found['surface'], note))
    return rows


def incline_dilating() -> list[Check]:
    """The layer of as few particles as the data have, of soil that regains what it loses."""
    soil, note = incline.beads(DILATION), f'K = {DILATION:g}, {_packed(1, SCENE_CELLS)}'
    (found,) = incline.bagnold(1, (2.0, 4.0), cells=SCENE_CELLS, soil=soil)
    speed = incline.halt(soil, RESTING_DEG['beads'], 1, SCENE_CELLS)
    name = 'incline, dilating beads'
    return [
        Check(f'{name}: depth over that before', found['depth'], 1.0, 0.05, f'2 to 4 s, {note}'),
        reported(f'{name}: surface speed over closed form', found['surface'], f'2 to 4 s, {note}'),
        Check(f'{name} at {RESTING_DEG["beads"]:g} degrees: mean speed after 3 s, mm/s',
              1e3 * speed, 0.0, 1.0, f'0.1 m/s at first; {note}'),
    ]  # fmt: skip


def incline_halt() -> list[Check]:
    """Below the static angle a layer comes to rest."""
    rows = []
    layers = (
        ('beads', incline.beads(), 2, 4),
        ('beads', incline.beads(), 1, SCENE_CELLS),
        ("the blade's soil", incline.soil_of_blade(), 2, 4),
    )
    for name, soil, denser, cells in layers:
        speed = incline.halt(soil, RESTING_DEG[name], denser, cells)
        title = f'incline, {name} at {RESTING_DEG[name]:g} degrees: mean speed after 3 s, mm/s'
        note = f'0.1 m/s at first; C = {incline.posedness(soil, 0.01):.2f} at I = 0.01'
        rows.append(Check(title, 1e3 * speed, 0.0, 1.0, f'{note}; {_packed(denser, cells)}'))
    return rows
