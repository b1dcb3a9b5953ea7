"""Table and picture of `reports edges`, from its JSON alone."""

import os
import re

import numpy as np

from learning_to_simulate.subspace import edge_lists, edge_picture
from pca_tools import files
from reports import markdown

ORDER = (
    'fully connected', 'all modes', 'NRI', 'learned gates', 'correlation',
    'correlation and self-edges', 'random', 'self-edges only', 'none',
)  # fmt: skip
METHOD_OF = {
    'NRI': 'nri', 'learned gates': 'gates', 'correlation': 'correlation',
    'correlation and self-edges': 'correlation', 'none': 'fixed', 'self-edges only': 'fixed',
    'all modes': 'fixed',
}  # fmt: skip
COLUMNS = (
    ('valid', 'of_best_trivial'), ('test', 'of_best_trivial'),
    ('valid', 'force_relative_l2'), ('test', 'force_relative_l2'),
)  # fmt: skip


def grouped(result: dict) -> dict[str, list[dict]]:
    """The rows of each variant in the order of the table; the random draws are one variant."""
    rows: dict[str, list] = {}
    for row in result['rows']:
        rows.setdefault(re.sub(r' \d+$', '', row['variant']), []).append(row)
    return {name: rows[name] for name in ORDER if name in rows}


def values_of(rows: list[dict], split: str, key: str) -> list[float]:
    """One figure of all rows that have it: a rollout that blew up has none."""
    return [row[split][key] for row in rows if row[split][key] is not None]


def table(result: dict) -> str:
    """The rows as Markdown: mean over seeds and, in brackets, the smallest and the largest."""
    b = result['budget']
    head = (
        f'{result["scene"]}, `pcg`: {b["num_steps"]} single steps, then {b["unroll_steps"]} steps '
        f'through rollouts of {b["unroll_length"]} frames (batch {b["unroll_batch_size"]}); lists '
        f'of {b["keep"]} mode edges; gates of price {b["gate_weight"]:g} learned in the first '
        f'{b["gate_steps"]} steps. Mean over trainings (smallest to largest).'
    )
    return f'{head}\n\n{cells_table(result)}'


def cells_table(result: dict) -> str:
    """The rows alone."""
    header = (
        'edges between modes', 'trainings', 'mode edges', 'all edges',
        'soil MSE of best trivial, valid', 'test', 'force rel. L2, valid', 'test', 'ms per step',
    )  # fmt: skip
    lines = []
    for name, rows in grouped(result).items():
        cells = [name, len(rows), _counts(rows), markdown.span([r['edges'] for r in rows])]
        for split, key in COLUMNS:
            values = values_of(rows, split, key)
            failed = f', {len(rows) - len(values)} failed' if len(values) < len(rows) else ''
            cells.append(markdown.span(values) + failed)
        timing = result['timing'].get(rows[0]['variant'])
        lines.append([*cells, timing and timing['ms_median']])
    return markdown.table(header, lines)


def of_file(path: str) -> str:
    """The rows of a stored comparison."""
    return cells_table(files.read_json(path))


def agreement(*paths: str) -> str:
    """How far the seeds of NRI agree: a row for each result of `reports nri_stability`."""
    header = ('', 'epochs', 'hidden', 'test loss of the seeds', 'edges in the seeds',
              'Jaccard (by chance)', 'same answer (by chance)', 'correlation of P(edge)',
              'in all seeds', 'in any seed')  # fmt: skip
    lines = []
    for path in paths:
        result = files.read_json(path)
        found, settings = result['compared'], result['settings']

        def beside_chance(key, found=found):
            return (
                f'{markdown.cell(found[key]["mean"])} ({markdown.cell(found[f"{key}_by_chance"])})'
            )

        lines.append(
            (re.sub(r'_nri\.json$', '', os.path.basename(path)), settings['epochs'],
             settings['hidden'], markdown.span([row['test_loss'] for row in result['seeds']]),
             markdown.span([row['edges'] for row in result['seeds']]), beside_chance('jaccard'),
             beside_chance('agreement'), found['correlation']['mean'], found['in_all_seeds'],
             found['in_any_seed'])
        )  # fmt: skip
    return markdown.table(header, lines)


def lists(*paths: str) -> str:
    """What lists of edges between the same modes hold, and how far each agrees with the others."""
    masks = [edge_lists.read(path).mask for path in paths]
    lines = []
    for path, mask in zip(paths, masks, strict=True):
        shared = [
            float((mask & other).sum() / (mask | other).sum())
            for other in masks
            if other is not mask and (mask | other).any()
        ]
        # Modes are counted from 1 in texts.
        pairs = ', '.join(f'{j + 1} to {i + 1}' for i, j in np.argwhere(mask))
        name = os.path.basename(path).removesuffix('.json').replace('_', ' ')
        own = int(np.trace(mask))
        lines.append((name, int(mask.sum()) - own, own, pairs, markdown.span(shared)))
    header = ('list', 'edges', 'self-edges', 'sender to receiver', 'Jaccard with the others')
    return markdown.table(header, lines)


def _counts(rows):
    known = [row for row in rows if row['mode_edges'] is not None]
    if not known:
        return 'all'
    edges, own = (markdown.span([r[key] for r in known]) for key in ('mode_edges', 'self_edges'))
    return f'{edges}, self {own}'


def edges_of(result: dict, variant: str) -> edge_lists.EdgeList:
    """The edge list of a variant: of its training with the smallest soil error on valid.

    Args:
      result: the JSON.
      variant: name of a row whose edges have a reason: not fully connected, not random.

    Raises:
      ValueError: if there is no such row.
    """
    rows = [r for r in result['rows'] if r['variant'] == variant and variant in METHOD_OF]
    rows = [r for r in rows if r['valid']['of_best_trivial'] is not None]
    if not rows:
        known = sorted({r['variant'] for r in result['rows']} & METHOD_OF.keys())
        raise ValueError(f'no list of {variant!r}; there are lists of {known}')
    best = min(rows, key=lambda row: row['valid']['of_best_trivial'])
    mask = np.array(best['mask'], bool)
    scores = np.array(mask if best['scores'] is None else best['scores'], np.float64)
    return edge_lists.EdgeList(
        mask=mask,
        node_names=edge_lists.mode_names(len(mask)),
        probabilities=scores,
        method=METHOD_OF[variant],
        threshold=None,
        digests={'model': None} | result['budget']['data'],
        degenerate=edge_lists.degeneracy(mask),
        report={
            'source': f'reports edges, {variant}, seed {best["seed"]}',
            'edges_kept': int(mask.sum()),
        },
    )


def draw(path: str, result: dict) -> None:
    """Errors of all trainings, variant by variant, and the edge lists of seed 0.

    Args:
      path: PNG file.
      result: the JSON.
    """
    variants = grouped(result)
    with_mask = {
        name: rows for name, rows in variants.items() if rows[0]['mask'] and name != 'none'
    }
    figure, axes = edge_picture.new_figure(max(len(with_mask), 2), 2)
    grid = axes[0, 0].get_gridspec()
    for axis in axes[0]:
        axis.remove()
    half = axes.shape[1] // 2
    panels = [figure.add_subplot(grid[0, :half]), figure.add_subplot(grid[0, half:])]
    titles = ('soil MSE over best trivial', 'force, relative L2')
    for panel, key, title in zip(panels, ('of_best_trivial', 'force_relative_l2'), titles):
        for place, rows in enumerate(variants.values()):
            for shift, split, colour in ((-0.12, 'valid', 'tab:blue'), (0.12, 'test', 'tab:red')):
                values = values_of(rows, split, key)
                panel.plot([place + shift] * len(values), values, 'o', color=colour, alpha=0.6)
                if values:
                    panel.plot(place + shift, np.mean(values), '_', color=colour, ms=18)
        panel.set_xticks(range(len(variants)), variants, rotation=30, ha='right')
        panel.set_title(f'{result["scene"]}: {title} (blue valid, red test)')
        panel.set_ylim(bottom=0)
        panel.grid(axis='y', alpha=0.3)
    for axis, (name, rows) in zip(axes[1], with_mask.items()):
        mask = np.array(rows[0]['mask'])
        edge_picture.show_matrix(axis, mask, edge_lists.mode_names(len(mask)))
        axis.set_title(f'{name}: {mask.sum()}', fontsize=10)
    for axis in axes[1, len(with_mask) :]:
        axis.remove()
    edge_picture.save(path, figure)


def write(result: dict, stem: str) -> str:
    """Writes `<stem>.md` and `<stem>.png`; returns the table.

    Raises:
      ValueError: if the JSON is of another kind.
    """
    try:
        text = table(result)
        draw(f'{stem}.png', result)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f'{stem}.json: not the result of reports edges ({error!r})') from error

    files.write_text(f'{stem}.md', text + '\n')
    return text
