"""Tables of a protocol document, as Markdown, from its JSON alone."""

import os

import numpy as np

from pca_tools import files
from reports import markdown
from reports.protocol import judge

TITLES = {
    'soil_mm': 'soil, mm',
    'near_mm': 'surface near the tool, mm',
    'front_mm': 'front of the cut, mm',
    'heap_error_litre': 'heap, litres',
    'force_relative_l2': 'force, rel. L2',
    'force_rmse': 'force, N',
    'drawbar_relative_l2': 'drawbar, rel. L2 (median)',
    'drawbar_rmse': 'drawbar, N',
    'pitch_relative_l2': 'torque, rel. L2 (median)',
    'height_mm': 'height, mm',
}
# Of a part of a load a run may have next to nothing; then its relative error is a huge number.
MEDIANS = 'drawbar_relative_l2', 'pitch_relative_l2'
# What decides; here tables of methods also state the range of trainings.
BOTH = 'soil_mm', 'force_relative_l2'
IN_SHORT = *BOTH, 'drawbar_relative_l2'
COLUMNS = {
    'blade': ('soil_mm', 'near_mm', 'front_mm', 'heap_error_litre', 'force_relative_l2',
              'drawbar_relative_l2', 'force_rmse'),
    'wheel': ('soil_mm', 'near_mm', 'height_mm', 'force_relative_l2', 'drawbar_relative_l2',
              'pitch_relative_l2', 'drawbar_rmse'),
}  # fmt: skip


def average(key: str, errors) -> float:
    """The mean of the errors of several runs, or their median; NaN if a run has none (None)."""
    return float((np.median if key in MEDIANS else np.mean)(np.array(errors, np.float64)))


def methods(path: str) -> str:
    """All methods over all runs: mean errors (medians of parts of a load, and where one
    was refused); below them the truth's own errors."""
    document = judge.read(path)
    summary, columns = document['summary']['all'], COLUMNS[document['scene']]
    count = sum(not run['data'] for run in document['runs'])
    rows = []
    for method in document['methods']:
        found = summary[method['name']]
        if not found:
            continue
        runs = max(figure['runs'] for figure in found.values())
        seeds = len(method['seeds'])
        refused = sum(len(s['errors'].get('refused', ())) for s in method['seeds'])
        about = ', '.join(
            [f'{seeds} trainings'] * (seeds > 1)
            + [f'{runs} runs'] * (runs < count)
            + [f'{refused} refused'] * bool(refused)
        )
        cells = [_cell(found.get(key), key, key in BOTH) for key in columns]
        rows.append([method['name'] + (f' ({about})' if about else ''), *cells])
    own, cells = document['truth'], _own(document, columns)
    # Of the whole bed; near the tool it is larger.
    cells[columns.index('near_mm')] = f'over {markdown.mean(own["surface_mm"])}'
    rows.append([f"*truth's own error* ({len(own['cases'])} cases)", *cells])
    return markdown.table(['method', *(TITLES[key] for key in columns)], rows)


def _own(document, columns):
    """The truth's own errors, as far as the ladder of grids knows them."""
    own = document['truth']
    return [markdown.cell(average(key, own[key])) if key in own else '' for key in columns]


def _cell(figure, key, ranges):
    """The figure of a method: mean over trainings, with their range if asked."""
    if figure is None:
        return ''
    show = markdown.span if ranges else markdown.mean
    if key in MEDIANS:
        return show(figure['median']) or 'failed'
    return f'median {show(figure["median"])}' if None in figure['mean'] else show(figure['mean'])


def in_short(blade: str, wheel: str) -> str:
    """One line: by how much the soil fields of two documents are off."""
    of_blade, of_wheel = (judge.read(p)['summary']['all']['soil field'] for p in (blade, wheel))

    def figure(found, key='mean'):
        key = 'median' if None in found[key] else key
        return np.mean([value for value in found[key] if value is not None])

    force = 100 * figure(of_blade['force_relative_l2'])
    drawbar = 100 * figure(of_wheel['drawbar_relative_l2'], 'median')
    return (
        f"- **How far off**: a blade's force by {force:.0f} %, its soil by "
        f"{figure(of_blade['soil_mm']):.1f} mm; a wheel's drawbar by {drawbar:.0f} % (median), its "
        f'soil by {figure(of_wheel["soil_mm"]):.1f} mm.'
    )


def new_tools(*paths: str) -> str:
    """What `lts new-tool` said last of some tools, by the state files of their folders."""
    rows = [
        (f'{made["asked"]["tool"]["name"]}, {100 * made["asked"]["tool"]["width"]:g} cm wide',
         str(made['asked']['runs']), made['verdict'])
        for made in map(files.read_json, paths)
    ]  # fmt: skip
    return markdown.table(['tool', 'runs', 'said'], rows)


def kinds(path: str, name: str = 'soil field') -> str:
    """Means of one method by kind of run."""
    rows = []
    for kind, of in judge.read(path)['summary'].items():
        if found := of.get(name):
            runs = max(figure['runs'] for figure in found.values())
            rows.append([kind, runs, *(_cell(found.get(key), key, False) for key in IN_SHORT)])
    return markdown.table(['runs', 'count', *(TITLES[key] for key in IN_SHORT)], rows)


def bounds(*paths: str) -> str:
    """Of each soil field with a bound: how many test runs keep it, and what the status tells."""
    rows = []
    for path in paths:
        document = judge.read(path)
        for method in document['methods']:
            seeds = [seed for seed in method['seeds'] if 'bounds' in seed]
            if not seeds:
                continue
            kept = [[k for k in s['errors'].get('bound_kept', []) if k is not None] for s in seeds]
            near = [
                [v <= s['bounds']['near_mm'] for v in s['errors'].get('near_95_mm', [])
                 if v is not None]
                for s in seeds
            ]  # fmt: skip
            ratios = [
                s['error_flagged'] / s['error_inside']
                if s.get('error_flagged') and s.get('error_inside') else None
                for s in seeds
            ]  # fmt: skip
            rows.append([
                f'{document["scene"]}: {method["name"]}',
                markdown.span([float(100 * np.mean(np.array(k) >= 0.95)) for k in kept]),
                markdown.span([float(100 * np.mean(n)) for n in near]),
                markdown.mean([100 * s['flagged_frames'] for s in seeds]),
                markdown.span(ratios),
            ])  # fmt: skip
    header = (
        'model', 'runs that keep the bound of the force, %', 'of the surface, %',
        'frames flagged, %', 'their error over that of others',
    )  # fmt: skip
    return markdown.table(header, rows)


# What ships of the judged methods: its name in the documents, its folder, what it is made for.
SHIPPED = {
    'soil field': ('soil_field', 'recommended'),
    'mlp_driven': ('mlp_driven', 'all particles at once, in the subspace'),
    'pcg': ('pcg', 'graph network, to compare with'),
}


def shipped(*paths: str) -> str:
    """The shipped models with their mean errors on the runs that all methods know, beside
    persistence and the truth's own errors."""
    rows = []
    for path in paths:
        document = judge.read(path)
        scene = os.path.basename(document['data'][0]['path'])
        figures = document['summary']['all']

        def cells(name, figures=figures):
            return [_cell(figures[name].get(q), q, True) for q in IN_SHORT]

        for name, (folder, purpose) in SHIPPED.items():
            if name in figures:
                rows.append((f'`{scene}/{folder}`', purpose, *cells(name)))
        rows.append((f'*{scene}: persistence*', 'soil and force stay', *cells('persistence')))
        own = f"*{scene}: truth's own error*", 'force: on cubic cells; drawbar: limit of fine cells'
        rows.append((*own, *_own(document, IN_SHORT)))
    return markdown.table(('model', 'for', *(TITLES[q] for q in IN_SHORT)), rows)
