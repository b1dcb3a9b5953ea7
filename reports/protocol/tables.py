"""Tables of a protocol document, as Markdown, from its JSON alone."""

import numpy as np

from pca_tools import files
from reports import markdown
from reports.protocol import over_runs
from reports.protocol.over_runs import ALL


def _span(figure, digits=3):
    """Mean and range over seeds; one number where all seeds agree."""
    return '' if figure is None else markdown.span(figure['seeds'], digits)


def _about(method):
    count = len(method['seeds'])
    return method['name'] if count == 1 else f'{method["name"]} ({count} seeds)'


def _shown(method):
    """Baselines stand out."""
    return f'*{_about(method)}*' if method['baseline'] else _about(method)


def quantity_table(document: dict, split: str, quantity: str, kind: str = ALL) -> str:
    """Median, mean, worst of all methods in one quantity, and over each baseline the geometric mean
    of the ratios and the wins."""
    rows = document['summary'][split][kind][quantity]
    baselines = [m['name'] for m in document['methods'] if m['baseline'] and m['name'] in rows]
    header = ['method', 'median', 'mean', 'worst']
    header += [f'over {name}' for name in baselines]
    cells = []
    for method in document['methods']:
        row = rows.get(method['name'])
        if row is None:
            continue
        count = row['runs']
        failed = row['failed']['mean'] if row['failed'] else 0
        line = [_shown(method)]
        line += [
            _span(row[key]) or ('failed' if failed else '') for key in ('median', 'mean', 'worst')
        ]
        for baseline in baselines:
            wins = f'wins {_span(row["wins"][baseline])} of {count}'
            ratio = _span(row['ratio'][baseline])
            same = baseline == method['name']
            line.append('' if same else f'{ratio}; {wins}' if ratio else wins)
        cells.append(line)
    return markdown.table(header, cells)


def training_table(document: dict) -> str:
    """Of every training whose checkpoints were judged on valid: its steps, and the mean error over
    the last quarter of them over that of the quarter before. '' where there is none."""
    rows = []
    for method in document['methods']:
        for seed in method['seeds']:
            if points := seed.get('curve'):
                flat = (_change(points, key) for key in ('soil_mse', 'force_mse'))
                rows.append((method['name'], seed['seed'], points[-1]['step'], *flat))
    header = ('method', 'seed', 'steps', 'last quarter over the one before: soil', 'force')
    return markdown.table(header, rows) if rows else ''


def _change(points, key):
    """Mean over the last quarter of the checkpoints, over that of the quarter before; None where
    one of them has no number, or there are fewer than four."""
    n = len(points) // 4
    known = [row[key] for row in points[-2 * n :] if n and row.get(key) is not None]
    return float(np.mean(known[n:]) / np.mean(known[:n])) if n and len(known) == 2 * n else None


# Tables of pages (`reports.documents`), of stored documents.

TITLES = {
    'soil_mm': 'soil, mm',
    'force_l2': 'force, rel. L2',
    'height_mm': 'height, mm',
    'torque_l2': 'torque, rel. L2',
    'pitch_l2': 'torque in the plane of travel, rel. L2',
}
# What ships of the judged methods: its name in the documents, its folder, what it is made for.
SHIPPED = {
    'swept_field': ('swept_field', 'recommended'),
    'mlp_driven': ('mlp_driven', 'all particles in 0.3 ms, in the subspace'),
    'pcg, 8 modes': ('pcg', 'graph network, to compare with'),
}


def means(path: str, split: str, *quantities: str) -> str:
    """Mean errors over all runs of a split: methods by quantities, (smallest to largest) over
    seeds."""
    document = files.read_json(path)
    figures = document['summary'][split][ALL]
    rows = []
    for method in document['methods']:
        found = [figures[q].get(method['name']) for q in quantities]
        if any(found):
            rows.append([_shown(method), *(f and _span(f['mean']) for f in found)])
    return markdown.table(['method', *(TITLES[q] for q in quantities)], rows)


def of_method(path: str, split: str, name: str, *quantities: str) -> str:
    """Mean errors of one method by kind of run, beside soil that stays as it is and a force that is
    held, and on how many runs the method is better in the first quantity."""
    summary = files.read_json(path)['summary'][split]
    columns = [(q, n) for q in quantities for n in (name, 'persistence') if n in summary[ALL][q]]
    rows = []
    for kind in (*sorted(summary.keys() - {ALL}), ALL):
        cells = (_span(summary[kind][q][n]['mean']) for q, n in columns)
        first = summary[kind][quantities[0]][name]
        wins = _span(first['wins']['persistence'])
        rows.append([kind, *cells, f'{wins} of {first["runs"]}'])
    titles = (TITLES[q] if n == name else n for q, n in columns)
    return markdown.table(['runs', *titles, 'better than persistence'], rows)


def shipped(*paths: str) -> str:
    """The shipped models with their mean errors on test, beside persistence."""
    rows = []
    for path in paths:
        document = files.read_json(path)
        scene = document['data']['path'].rstrip('/').rpartition('/')[2]
        figures = document['summary']['test'][ALL]
        spans = {
            name: [_span(figures[q][name]['mean']) for q in ('soil_mm', 'force_l2')]
            for name in figures['soil_mm'].keys() & figures['force_l2'].keys()
        }
        for name, (folder, purpose) in SHIPPED.items():
            if name in spans:
                rows.append((f'`{scene}/{folder}`', purpose, *spans[name]))
        rows.append((f'*{scene}: persistence*', 'soil and force stay', *spans['persistence']))
    return markdown.table(('model', 'for', TITLES['soil_mm'], TITLES['force_l2']), rows)


def sizes(*paths: str) -> str:
    """Mean errors of driven test runs (else of all) by number of training runs, of stored documents
    of parts of one dataset; (low to high) over seeds."""
    found = []
    for path in paths:
        document = files.read_json(path)
        errors = over_runs.condense(document)
        judged = errors.get(over_runs.DRIVEN) or errors[over_runs.GRID]
        found.append((document['data']['train_runs'], judged))
    columns = [(q, name) for q in ('soil_mm', 'force_l2') for name in found[-1][1][q]]
    lines = [
        (count, *(markdown.span(errors[q].get(name, [])) for q, name in columns))
        for count, errors in sorted(found, key=lambda row: row[0])
    ]
    titles = (f'{name}: {TITLES[q]}' for q, name in columns)
    return markdown.table(('training runs', *titles), lines)


def complete(document: dict) -> dict:
    """The document with all figures that its tables print, made from its runs."""
    methods = [
        method | {'median_seed': over_runs.median_seed(method['seeds'])}
        for method in document['methods']
    ]
    document = document | {'methods': methods}
    return document | {'summary': over_runs.summarise(document)}
