"""Tables of cases."""

import itertools

import pytest

from mpm import scenes


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=str)
def test_numbers_are_nested_loops(scene):
    expected = list(itertools.product(*scene.levels.values()))
    assert scene.case_count == len(expected)
    for case in (0, len(expected) + 1):
        with pytest.raises(ValueError, match=f'cases 1 to {len(expected)}, got {case}'):
            scene.parameters(case)
    for case, values in enumerate(expected, 1):
        assert tuple(scene.parameters(case).values()) == values
    chosen = [scene.parameters(case) for case in sorted({*scene.mini} - {scene.demo_case})]
    assert len(chosen) == 40
    for name, levels in scene.levels.items():
        counts = [sum(one[name] == level for one in chosen) for level in levels]
        assert max(counts) - min(counts) <= 1


def test_published_wheel_contexts():
    """Contexts of published records, as they stand in their files."""
    expected = {44: (1.62, 37.0, 164.0), 154: (3.72, 30.0, 25.0), 203: (9.81, 37.0, 164.0)}
    for case, values in expected.items():
        parameters = scenes.WHEEL.parameters(case)
        ground = scenes.ground_of(scenes.WHEEL, parameters)
        found = ground.gravity, ground.friction_angle_deg, scenes.wheel_load(parameters)
        assert found == pytest.approx(values)
    small = scenes.WHEEL.parameters(122) | {'diameter_m': 0.05}
    assert scenes.wheel_load(small) == pytest.approx(164.0 / 9)
