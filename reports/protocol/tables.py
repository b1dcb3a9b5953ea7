"""Tables of a protocol document, as Markdown, from its JSON alone."""

from reports import markdown
from reports.protocol import over_runs
from reports.protocol.over_runs import ALL, QUANTITIES, QUIET_MM


def _span(figure, digits=3):
    """Mean and range over seeds; one number where all seeds agree."""
    return '' if figure is None else markdown.span(figure['seeds'], digits)


def _about(document, method):
    count = len(method['seeds'])
    return method['name'] if count == 1 else f'{method["name"]} ({count} seeds)'


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
        name = _about(document, method)
        failed = row['failed']['mean'] if row['failed'] else 0
        line = [f'*{name}*' if method['baseline'] else name]
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
                _about(document, method),
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


def scene_report(document: dict, split: str = 'test') -> str:
    """All tables of one scene and split, with their headings."""
    data = document['data']
    counts = document['runs'][split]
    quiet = sum(run['motion_mm'] < QUIET_MM for run in counts)
    parts = [
        f'## {document["scene"]}, {split}',
        f'Data version {data["version"]}, {len(counts)} runs ({_kinds(counts)}), {quiet} of them '
        f'quiet (below {QUIET_MM:g} mm). Truth: {data["truth"]}. Particle spacing '
        f'{data["spacing_mm"]:.1f} mm. JSON: `{document["file"]}`.',
    ]
    kinds = list(document['summary'][split])
    for quantity, title in QUANTITIES.items():
        for kind in kinds:
            if document['summary'][split][kind].get(quantity):
                suffix = '' if kind == ALL else f', {kind}'
                parts += [f'### {title}{suffix}', quantity_table(document, split, quantity, kind)]
        if quantity == 'soil_mm' and document['horizons'][split]:
            parts += ['### Soil after a time, mm', horizon_table(document, split)]
    for quantity in ('soil_mm', 'force_l2'):
        if document['summary'][split][ALL].get(quantity):
            title = QUANTITIES[quantity]
            parts += [f'### Every run: {title}', run_table(document, split, quantity)]
    return '\n\n'.join(parts)


def _kinds(runs):
    kinds = [run['kind'] for run in runs]
    return ', '.join(f'{kinds.count(kind)} {kind}' for kind in sorted(set(kinds)))


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
