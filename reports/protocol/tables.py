"""Tables of a protocol document, as Markdown, from its JSON alone."""

from pca_tools import files
from reports import markdown
from reports.protocol import curve, driven_runs, over_runs, reliability
from reports.protocol.over_runs import ALL, QUIET_MM


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


def kind_table(document: dict, split: str, quantity: str) -> str:
    """Mean error of all methods by kind of run, and over all runs."""
    summary = {k: v[quantity] for k, v in document['summary'][split].items() if quantity in v}
    kinds = [*sorted(summary.keys() - {ALL}), ALL]
    of_kind = [next(iter(summary[kind].values()))['runs'] for kind in kinds]
    header = ['method', *(f'{kind} ({n})' for kind, n in zip(kinds, of_kind, strict=True))]
    rows = []
    for method in document['methods']:
        if (name := method['name']) in summary[ALL]:
            rows.append([_shown(method), *(_span(summary[kind][name]['mean']) for kind in kinds)])
    return markdown.table(header, rows)


def horizon_table(document: dict, split: str) -> str:
    """Median error after given times, and runs that pass the spacing of the particles."""
    rows = []
    names = None
    for method in document['methods']:
        figures = document['horizons'][split].get(method['name'])
        if not figures:
            continue
        names = names or list(figures['median_mm'])
        first = figures['first_beyond_spacing_s']
        rows.append(
            [
                _about(method),
                *(_span(figures['median_mm'][n]) for n in names),
                _span(figures['runs_beyond_spacing']),
                '' if first is None else f'{first:.2f}',
            ]
        )
    titles = [n if n == 'end' else f'{n} s' for n in names or []]
    return markdown.table(['method', *titles, 'runs beyond spacing', 'first, s'], rows)


def run_table(document: dict, split: str, quantity: str) -> str:
    """The error of every run: methods as columns, each at its median seed on valid."""
    methods = [
        (m, m['seeds'][m['median_seed']]['runs'][split])
        for m in document['methods']
        if any(quantity in run for run in m['seeds'][m['median_seed']]['runs'][split])
    ]
    header = ['run', 'kind', 'motion, mm', 'truncation, mm', *(m['name'] for m, _ in methods)]
    rows = []
    for i, run in enumerate(document['runs'][split]):
        quiet = ' (quiet)' if run['motion_mm'] < QUIET_MM else ''
        rows.append(
            [f'{run["case"]}{quiet}', run['kind'], run['motion_mm'], run['truncation_mm']]
            + [errors[i].get(quantity) for _, errors in methods]
        )
    return markdown.table(header, rows)


def reliability_table(document: dict) -> str:
    """Mean bound and error of a frame, how many frames of test keep their bound, and of how many
    runs 95 % of them."""
    rows = []
    for method in document['methods']:
        known = method.get('reliability') or {}
        cells = [
            known[quantity][key] if quantity in known else None
            for quantity in reliability.UNITS
            for key in ('error', 'bound', 'within', 'runs_within')
        ]
        if known:
            rows.append([_shown(method), *cells])
    titles = [
        f'{quantity}: {title}'
        for quantity, unit in reliability.UNITS.items()
        for title in (f'error, {unit}', f'bound, {unit}', 'frames within', 'runs within')
    ]
    return markdown.table(['method', *titles], rows)


def training_table(document: dict) -> str:
    """Of every training whose checkpoints were judged on valid: its steps, and the mean error over
    the last quarter of them over that of the quarter before. '' where there is none."""
    rows = []
    for method in document['methods']:
        for seed in method['seeds']:
            if points := seed.get('curve'):
                flat = (curve.change(points, key) for key in ('soil_mse', 'force_mse'))
                rows.append((method['name'], seed['seed'], points[-1]['step'], *flat))
    header = ('method', 'seed', 'steps', 'last quarter over the one before: soil', 'force')
    return markdown.table(header, rows) if rows else ''


def facts_table(document: dict) -> str:
    """What the judged data are, split by split."""
    rows = []
    for split, runs in document['runs'].items():
        kinds = [run['kind'] for run in runs]
        counted = ', '.join(f'{kinds.count(kind)} {kind}' for kind in sorted(set(kinds)))
        quiet = [str(run['case']) for run in runs if run['motion_mm'] < QUIET_MM]
        rows.append([split, counted, ', '.join(quiet), document['data']['truth']])
    return markdown.table(['split', 'runs', 'quiet cases', 'truth'], rows)


# The same of stored documents, for the tables of pages (`reports.documents`).


def facts(path: str) -> str:
    """`facts_table` of a stored document."""
    return facts_table(files.read_json(path))


def quantity(path: str, split: str, name: str, kind: str = ALL) -> str:
    """`quantity_table` of a stored document."""
    return quantity_table(files.read_json(path), split, name, kind)


def by_kind(path: str, split: str, name: str) -> str:
    """`kind_table` of a stored document."""
    return kind_table(files.read_json(path), split, name)


def bounds(path: str) -> str:
    """`reliability_table` of a stored document."""
    return reliability_table(files.read_json(path))


def horizons(path: str, split: str) -> str:
    """`horizon_table` of a stored document."""
    return horizon_table(files.read_json(path), split)


def runs(path: str, split: str, name: str) -> str:
    """`run_table` of a stored document."""
    return run_table(files.read_json(path), split, name)


def sizes(*paths: str) -> str:
    """Mean errors of driven test runs (else of all) by number of training runs, of stored documents
    of parts of one dataset; (low to high) over seeds."""
    found = []
    for path in paths:
        document = files.read_json(path)
        errors = driven_runs.condense(document)
        judged = errors.get(driven_runs.DRIVEN) or errors[driven_runs.GRID]
        found.append((document['data']['train_runs'], judged))
    columns = [(q, name) for q in driven_runs.QUANTITIES for name in found[-1][1][q]]
    lines = [
        (count, *(markdown.span(errors[q].get(name, [])) for q, name in columns))
        for count, errors in sorted(found, key=lambda row: row[0])
    ]
    titles = (f'{name}: {driven_runs.QUANTITIES[q]}' for q, name in columns)
    return markdown.table(('training runs', *titles), lines)


def complete(document: dict) -> dict:
    """The document with all figures that its tables print, made from its runs."""
    methods = [
        method | {'median_seed': over_runs.median_seed(method['seeds'])}
        for method in document['methods']
    ]
    document = document | {'methods': methods}
    return document | {
        'summary': over_runs.summarise(document),
        'horizons': {
            split: {m['name']: h for m in methods if (h := over_runs.horizons(document, split, m))}
            for split in document['runs']
        },
    }
