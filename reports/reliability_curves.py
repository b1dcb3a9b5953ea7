"""Reliability curves: the error of a frame against the bound that was promised, method by method.

From JSON files of `reports.protocol` alone (`reliability`): frames of test in groups of equal size
by their bound. A bound that says something grows with the error, and lies above it.

Examples:
    python -m reports reliability --protocol=docs/protocol/excavation_v2.json \\
        --protocol=docs/protocol/wheel_v2.json --output_path=docs/protocol/reliability.png
"""

from absl import flags

from pca_tools import files
from reports import command
from reports.protocol import reliability


def draw(protocols: list[str], picture: str) -> None:
    """Draws the curves of documents, a row each: soil on the left, force on the right.

    Raises:
      ValueError: a document of before bounds were judged.
    """
    from matplotlib import figure, ticker

    drawn = figure.Figure(figsize=(11, 3.6 * len(protocols)), layout='constrained')
    grid = drawn.subplots(len(protocols), len(reliability.UNITS), squeeze=False)
    for path, row in zip(protocols, grid, strict=True):
        document = files.read_json(path)
        if not any(method.get('reliability') for method in document['methods']):
            raise ValueError(f'{path}: has no bounds; make it again with `reports.protocol`')
        for axes, (quantity, unit) in zip(row, reliability.UNITS.items(), strict=True):
            _draw_methods(axes, document['methods'], quantity)
            axes.set(
                xscale='log', yscale='log', xlabel=f'promised bound, {unit}',
                ylabel=f'error of {quantity}, {unit}', title=document['scene'],
            )  # fmt: skip
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_minor_formatter(ticker.NullFormatter())
            axes.grid(alpha=0.3)
        shown = dict(pair for axes in row for pair in zip(*axes.get_legend_handles_labels()[::-1]))
        row[-1].legend(
            shown.values(), shown, loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False,
            fontsize='x-small',
        )  # fmt: skip
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=130))


def _draw_methods(axes, methods, quantity):
    from matplotlib import colormaps

    colours = colormaps['tab20'].colors  # dark and light in turns: first all dark ones
    least, most = float('inf'), 0.0
    for number, method in enumerate(methods):
        known = method.get('reliability', {}).get(quantity)
        if known is None:
            continue
        bounds, errors = ([group[key] for group in known['curve']] for key in ('bound', 'error'))
        axes.plot(
            bounds, errors, 'o--' if method['baseline'] else 'o-', ms=3, lw=1,
            color=colours[(2 * number + 2 * number // len(colours)) % len(colours)],
            label=method['name'],
        )  # fmt: skip
        least, most = min(least, *bounds), max(most, *bounds)
    axes.plot([least, most], [least, most], color='0.6', lw=1, label='error = bound')


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_multi_string('protocol', None, 'JSON of `reports.protocol`.', required=True)
    flags.DEFINE_string('output_path', None, 'Picture to write (.png).', required=True)


def main(values, _) -> None:
    """Runs the command."""
    draw(values.protocol, values.output_path)
    print(f'wrote {values.output_path}')


if __name__ == '__main__':
    command.start(define_flags, main)
