"""Checks that need no run of a scene."""

from mpm import experiments
from mpm.verification.rows import Check


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
