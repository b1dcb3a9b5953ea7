"""A protocol document whose figures are known: two trainings, three runs, one of other data."""

TRUTH = {
    'cases': ['a', 'b'],
    'surface_mm': [1.0, 3.0],
    'force_relative_l2': [0.1, 0.3],
    'drawbar_relative_l2': [0.5, 0.7],
}


def document() -> dict:
    """Errors of `soil field` are 1, 2 and 9 mm and twice that in its second training, which refuses
    the second run; persistence has 3 everywhere."""
    runs = [
        {'data': data, 'case': case, 'kind': kind}
        for data, case, kind in ((0, '1', 'grid'), (0, 'lift_1', 'lift'), (1, 'beside_1', 'beside'))
    ]
    seeds = [
        {'seed': 0, 'errors': {
            'soil_mm': [1.0, 2.0, 9.0], 'force_relative_l2': [0.1, 0.3, 0.5],
            'drawbar_relative_l2': [0.1, 0.4, 0.5],
        }},
        {'seed': 1, 'errors': {
            'soil_mm': [2.0, None, 18.0], 'force_relative_l2': [0.2, None, 0.5],
            'drawbar_relative_l2': [0.2, None, 0.5], 'refused': [1],
        }},
    ]  # fmt: skip
    still = {'soil_mm': [3.0, 3.0, 3.0], 'force_relative_l2': [1.0, 1.0, 1.0]}
    mlp = {'soil_mm': [4.0, 1.0, None], 'force_relative_l2': [0.5, 1.5, None]}
    methods = [
        {'name': 'soil field', 'seeds': seeds},
        {'name': 'mlp_driven', 'seeds': [{'seed': 0, 'errors': mlp}]},
        {'name': 'persistence', 'seeds': [{'errors': still}]},
    ]
    return {
        'scene': 'blade', 'data': [{'path': 'datasets/excavation'}, {'path': 'datasets/wide'}],
        'runs': runs, 'methods': methods, 'truth': TRUTH,
    }  # fmt: skip
