"""Pictures of edge lists: senders x receivers, as in figures 3.5 to 3.7 of Usmani 2023."""

import re

import numpy as np

from pca_tools import files


def draw(path: str, edges, completed=None) -> None:
    """Draws probabilities, kept edges and, where given, the graph that Algorithm 2 makes of them.

    Args:
      path: PNG file.
      edges: `EdgeList`.
      completed: (`Adjacency`, node names) of the whole graph, or None.

    Raises:
      ValueError: matplotlib is missing.
    """
    panels = [
        ('probability', edges.probabilities, edges.node_names),
        (f'{edges.n_edge} edges ({edges.method})', edges.mask.astype(float), edges.node_names),
    ]
    if completed:
        adjacency, names = completed
        panels.append((f'Algorithm 2: {adjacency.n_edge} edges', adjacency.mask() * 1.0, names))
    figure, axes = new_figure(len(panels))
    for axis, (title, matrix, names) in zip(axes[0], panels):
        shown = show_matrix(axis, matrix, names)
        axis.set_title(title, fontsize=10)
        if title == 'probability':
            bar = figure.colorbar(shown, ax=axis, shrink=0.75)
            if edges.threshold is not None:
                bar.ax.axhline(edges.threshold, color='red')
    save(path, figure)


def show_matrix(axis, matrix, names):
    """One matrix [receiver, sender] on an axis: rows are senders, columns receivers."""
    shown = axis.imshow(np.asarray(matrix).T, cmap='gray_r', vmin=0, vmax=1)
    axis.set_facecolor('#cfe3f5')  # where the method has no probability
    labels = [re.sub('mode_(.*)', lambda m: str(int(m[1]) + 1), n) for n in names]
    rigid = sum(not n.startswith('mode_') for n in names)
    if 0 < rigid < len(names):
        # Four blocks: body and modes, as senders and as receivers.
        axis.axhline(rigid - 0.5, color='tab:red', lw=1)
        axis.axvline(rigid - 0.5, color='tab:red', lw=1)
        ticks = [(rigid - 1) / 2, rigid + (len(names) - rigid - 1) / 2]
        labels = ['body', 'modes']
    else:
        ticks = range(len(names))
    axis.set_xticks(ticks, labels, fontsize=8)
    axis.set_yticks(ticks, labels, fontsize=8)
    axis.set_xlabel('receiver')
    axis.set_ylabel('sender')
    return shown


def new_figure(columns: int):
    """A figure of panels of one matrix each; returns (figure, axes [1, columns]).

    Raises:
      ValueError: matplotlib is missing; it is an optional part of the installation.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError(
            'pictures need matplotlib: pip install -c constraints.txt -e .[viz]'
        ) from error
    figure = Figure(figsize=(4.2 * columns, 4.7), layout='constrained')
    return figure, figure.subplots(1, columns, squeeze=False)


def save(path: str, figure) -> None:
    """Writes a figure as PNG, whole or not at all."""
    files.write_atomically(path, lambda name: figure.savefig(name, format='png', dpi=110))
