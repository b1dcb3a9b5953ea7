"""The one writer of tables."""

import math

import pytest

from pca_tools.storage import markdown


@pytest.mark.parametrize(
    ('value', 'text'),
    [(None, ''), ('a', 'a'), (7, '7'), (7.0, '7'), (0.05828, '0.0583'), (9.63e-14, '9.63e-14'),
     (123.4, '123'), (5175.2, '5175'), (-1234.0, '-1234'), (2.5e12, '2.5e+12'), (math.nan, 'nan')],
)  # fmt: skip
def test_cells(value, text):
    assert markdown.cell(value) == text


def test_rows_are_filled_up_and_bars_in_a_cell_are_kept_apart():
    text = markdown.table(('a', '|b|'), [['x'], [1.0, 'y']])
    assert text.splitlines() == ['| a | \\|b\\| |', '|---|---|', '| x |  |', '| 1 | y |']
    with pytest.raises(ValueError, match='3 cells under 2 titles'):
        markdown.table(('a', 'b'), [[1, 2, 3]])
