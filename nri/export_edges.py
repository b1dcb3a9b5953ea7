"""Exports the graph that an NRI model found: `edges.json` and its picture.

Examples:
  # edges of probability above 0.6, as in the thesis
  python -m nri.export_edges --model_path=/tmp/nri_excavation --data_path=datasets/excavation \\
      --output_path=/tmp/edges

  # the 20 most probable ones
  python -m nri.export_edges --model_path=/tmp/nri_excavation --data_path=datasets/excavation \\
      --output_path=/tmp/edges --keep=20

Writes edges.json (schema in docs/data.md; a training takes it by `--adjacency`) and edges.png
(senders x receivers). NRI knows no self-edges; they carry nothing that a node's own update does not
see. A graph without any edge, or with all of them, is not exported unless --allow_degenerate is
given: it says that the encoder collapsed, not what the soil does.
"""

import os
import re

import numpy as np
from absl import flags

from learning_to_simulate import command
from learning_to_simulate.subspace import edge_lists
from nri import data as nri_data
from pca_tools import files

PICTURE_FILE = 'edges.png'


def edge_posterior(model, features) -> np.ndarray:
    """P(edge) of every ordered pair of nodes in every run: that of all types but the first, float64
    [S, V, V], entry [receiver, sender], NaN on the diagonal. `features` are float32 [S, V, T, F] as
    `data.load` gives them."""
    types = model.edge_probabilities(features)
    n_node = features.shape[1]
    matrix = np.full((len(types), n_node, n_node), np.nan)
    matrix[:, ~np.eye(n_node, dtype=bool)] = 1.0 - types[:, :, 0].astype(np.float64)
    return np.clip(matrix, 0.0, 1.0)


def spread(posterior, threshold: float) -> dict:
    """How sure the model is, and how far the runs agree, by a posterior of `edge_posterior`.

    `std_over_runs` of P(edge), mean over pairs; `entropy_bits` of P(edge), mean over pairs and runs
    (0 sure, 1 nothing known); `run_agreement`, the share of (run, pair) on the same side of the
    threshold as the mean over runs."""
    p = posterior[:, ~np.eye(posterior.shape[1], dtype=bool)]
    q = np.clip(p, 1e-12, 1.0 - 1e-12)
    entropy = -(q * np.log2(q) + (1 - q) * np.log2(1 - q))
    return {
        'runs': len(p),
        'std_over_runs': float(p.std(axis=0).mean()),
        'entropy_bits': float(entropy.mean()),
        'run_agreement': float(((p > threshold) == (p.mean(axis=0) > threshold)).mean()),
    }


def find_edges(
    model_path: str,
    data_path: str,
    *,
    threshold: float = 0.6,
    keep: int | None = None,
    allow_degenerate: bool = False,
) -> edge_lists.EdgeList:
    """The edge list of an NRI model, by its posterior on the training runs; arguments as the flags
    of the same names.

    FileNotFoundError, ValueError: no model or data there, data of another dataset, edge types
    without a meaning, an empty or saturated graph."""
    from nri.model import load_model  # loads TensorFlow; help does not wait for it

    model = load_model(model_path)
    data = nri_data.load(data_path, 'train', model.config.nodes, model.config.modes)
    if data.digest != model.data_digest:
        raise ValueError(
            f'{model_path} was trained on other data (sha256 {model.data_digest[:12]}...) than '
            f'{data_path} (sha256 {data.digest[:12]}...)'
        )
    if not model.config.skip_first:
        raise ValueError(f'{model_path} was trained without skip_first: no type means "no edge"')
    posterior = edge_posterior(model, data.features)
    probabilities = posterior.mean(axis=0)
    limit = threshold if keep is None else None
    mask = edge_lists.select(probabilities, threshold=limit, keep=keep)
    found = edge_lists.degeneracy(mask)
    if found and not allow_degenerate:
        p = probabilities[~np.isnan(probabilities)]
        raise ValueError(
            f'the graph is {found}: probabilities reach from {p.min():.3f} to {p.max():.3f}, the '
            f'threshold is {threshold}; give --keep or another --threshold, or --allow_degenerate '
            f'to export it all the same'
        )
    digests = {'model': model.digest, 'data': data.digest} | edge_lists.data_digests(data_path)
    report = spread(posterior, threshold) | {'split': 'train'}
    return edge_lists.EdgeList(
        mask, data.node_names, probabilities, 'nri', limit, digests, found, report
    )


def export(edges: edge_lists.EdgeList, output_path: str) -> list[str]:
    """Writes edges.json and edges.png; returns their names."""
    os.makedirs(output_path, exist_ok=True)
    names = [os.path.join(output_path, name) for name in (edge_lists.FILE_NAME, PICTURE_FILE)]
    edge_lists.write(names[0], edges)
    draw(names[1], edges)
    return names


def draw(path: str, edges) -> None:
    """Draws probabilities and kept edges, senders x receivers, as in figures 3.5 to 3.7 of Usmani
    2023."""
    panels = [
        ('probability', edges.probabilities, edges.node_names),
        (f'{edges.n_edge} edges ({edges.method})', edges.mask.astype(float), edges.node_names),
    ]
    figure, images = show_matrices(panels)
    bar = figure.colorbar(images[0], ax=images[0].axes, shrink=0.75)
    if edges.threshold is not None:
        bar.ax.axhline(edges.threshold, color='red')
    save(path, figure)


def show_matrices(panels):
    """A figure of (title, matrix [receiver, sender], node names) side by side; rows are senders,
    columns receivers. Returns it and its images."""
    from matplotlib.figure import Figure  # optional: the extra [viz]

    figure, images = Figure(figsize=(4.2 * len(panels), 4.7), layout='constrained'), []
    for axis, (title, matrix, names) in zip(figure.subplots(1, len(panels)), panels):
        images.append(axis.imshow(np.asarray(matrix).T, cmap='gray_r', vmin=0, vmax=1))
        axis.set_facecolor('#cfe3f5')  # where the method has no probability
        labels = [re.sub('mode_(.*)', lambda m: str(int(m[1]) + 1), n) for n in names]
        rigid = sum(not n.startswith('mode_') for n in names)
        ticks = list(range(len(names)))
        if 0 < rigid < len(names):
            # Four blocks: body and modes, as senders and as receivers.
            axis.axhline(rigid - 0.5, color='tab:red', lw=1)
            axis.axvline(rigid - 0.5, color='tab:red', lw=1)
            ticks = [(rigid - 1) / 2, rigid + (len(names) - rigid - 1) / 2]
            labels = ['body', 'modes']
        axis.set_xticks(ticks, labels, fontsize=8)
        axis.set_yticks(ticks, labels, fontsize=8)
        axis.set(xlabel='receiver', ylabel='sender')
        axis.set_title(title, fontsize=10)
    return figure, images


def save(path: str, figure) -> None:
    """Writes a figure as PNG, whole or not at all."""
    files.write_atomically(path, lambda name: figure.savefig(name, format='png', dpi=110))


def define_flags():
    flags.DEFINE_string('model_path', None, 'Folder of the NRI model.', required=True)
    flags.DEFINE_string('data_path', None, 'The data it was trained on.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder for the files.', required=True)
    flags.DEFINE_float('threshold', 0.6, 'Edges have a probability above it.', 0.0, 1.0)
    flags.DEFINE_integer('keep', None, 'Instead: number of edges, the most probable ones.', 0)
    flags.DEFINE_bool('allow_degenerate', False, 'Export an empty or saturated graph too.')


def main(v):
    command.import_tensorflow()
    edges = find_edges(
        v.model_path, v.data_path, threshold=v.threshold, keep=v.keep,
        allow_degenerate=v.allow_degenerate,
    )  # fmt: skip
    names = export(edges, v.output_path)
    r, n_node = edges.report, len(edges.node_names)
    print(
        f'{edges.n_edge} of {n_node * (n_node - 1)} edges between {n_node} nodes; '
        f'{r["runs"]} runs: probabilities differ by {r["std_over_runs"]:.3f} (std), '
        f'{r["run_agreement"]:.0%} agree with the mean, entropy {r["entropy_bits"]:.2f} bits'
    )
    print('wrote ' + ', '.join(names))


if __name__ == '__main__':
    define_flags()
    command.start(main)
