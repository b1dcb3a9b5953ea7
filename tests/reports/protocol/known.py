"""A judged document whose errors are known."""

RUNS = [
    {'kind': 'grid', 'motion_mm': 9.0},
    {'kind': 'lift', 'motion_mm': 9.0},
    {'kind': 'stops', 'motion_mm': 0.1},  # hardly moves: only its force counts
]


def document(train_runs, scale):
    def seed(factor):
        soil, force = [2.0, 4.0, 99.0], [0.1, 0.2, 0.4]
        rows = [
            {'soil_mm': factor * s, 'force_l2': factor * f}
            for s, f in zip(soil, force, strict=True)
        ]
        return {'seed': 0, 'runs': {'test': rows}}

    ridge = seed(1.0)
    ridge['runs']['test'][0]['soil_mm'] = None  # a run that failed
    methods = [
        {'name': 'field', 'seeds': [seed(scale), seed(3 * scale)]},
        {'name': 'path ridge', 'seeds': [ridge]},
    ]
    return {'data': {'train_runs': train_runs}, 'runs': {'test': RUNS}, 'methods': methods}
