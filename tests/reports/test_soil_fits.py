"""The report of soil fits: its summary in closed form, and what `lts fit-soil` takes from it."""

import pathlib

import pytest

from learning_to_simulate.soil_field import fit_soil
from pca_tools import files
from reports import soil_fits

RECORD = pathlib.Path(__file__).resolve().parents[2] / 'docs' / 'soil_fits.json'


def test_the_summary_of_known_errors():
    rows = [
        {'angle_deg': 31.0, 'true_angle_deg': 30.0, 'angle_spread_deg': 0.4, 'density': 1500.0,
         'true_density': 1000.0},
        {'angle_deg': 33.0, 'true_angle_deg': 36.0, 'angle_spread_deg': 2.0, 'density': 1000.0,
         'true_density': 1000.0},
        {'angle_deg': None},
    ]  # fmt: skip
    found = soil_fits.summary(rows)
    assert (found['fits'], found['told'], found['angle_worst_deg']) == (3, 2, 3.0)
    assert found['angle_rms_deg'] == pytest.approx(5.0**0.5) and found['angle_bias_deg'] == -1.0
    assert (found['within_2_deg'], found['within_2_spreads']) == (0.5, 0.5)
    assert found['density_rms'] == pytest.approx(0.125**0.5)
    assert soil_fits.summary(rows[2:]) == {'fits': 1, 'told': 0}


def test_what_a_model_is_off_comes_from_runs_that_do_not_judge():
    """The constants are near those of the record, and no run that calibrates judges."""
    record = files.read_json(RECORD)
    free, given = (record['summary'][f'calibration{of}'] for of in ('', ', density given'))
    assert pytest.approx((free['angle_rms_deg'], free['density_rms']), rel=0.05) == fit_soil.OFF
    assert pytest.approx(given['angle_rms_deg'], rel=0.05) == fit_soil.OFF_GIVEN
    used, judged = ({row['name'] for row in record['fits'][of]} for of in ('calibration', 'single'))
    assert used and judged and not used & judged
