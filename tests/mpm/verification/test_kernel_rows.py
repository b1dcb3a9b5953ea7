"""Rows that need no run of a scene, within tighter bounds than a report asks for."""

import pytest

from mpm.verification import kernel_rows


@pytest.mark.parametrize(
    ('row', 'arguments', 'bound'),
    [
        ('free_fall', (), 1e-12),  # measured 1e-15 and 2e-15
        ('momentum', (), 1e-12),  # measured 6e-16
        ('shear', ((1e-4, 0.01, 0.3, 10.0),), 1e-5),  # 1e-7: what is left is the strain still to go
        ('column', (1.0,), 0.2),  # 1.12 of 1.2 a; the published scatter is 10 to 20 %
    ],
)
def test_rows_are_as_expected(row, arguments, bound):
    for check in getattr(kernel_rows, row)(*arguments):
        assert check.passed and check.figure == pytest.approx(check.expected, abs=bound), check
