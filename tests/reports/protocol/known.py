"""Documents whose errors are known."""

KINDS = {'grid': 9.0, 'lift': 9.0, 'stops': 0.1}  # the last hardly moves: only its force counts
RUNS = [{'kind': kind, 'motion_mm': motion} for kind, motion in KINDS.items()]


def document(train_runs, scale):
    """'field' of two seeds, and 'path ridge', of which a run failed."""

    def seed(factor, first=2.0):
        soil, force = [first, 4.0, 99.0], [0.1, 0.2, 0.4]
        rows = [
            {'soil_mm': s and factor * s, 'force_l2': factor * f}
            for s, f in zip(soil, force, strict=True)
        ]
        return {'seed': 0, 'runs': {'valid': rows, 'test': rows}}

    methods = [
        {'name': 'field', 'baseline': False, 'seeds': [seed(scale), seed(3 * scale)]},
        {'name': 'path ridge', 'baseline': True, 'seeds': [seed(1.0, None)]},
    ]
    runs = {'valid': RUNS, 'test': RUNS}
    return {'data': {'train_runs': train_runs}, 'runs': runs, 'methods': methods}
