"""The published configurations trained longer, beside the published figures, from stored rows.

Published: M. J. Usmani & K. Skonieczny (2023), "Accelerating Graph Networks for Real-Time Physics
Simulation", Table 3.3: mean squared error of soil over 9 test runs, and for each of them the mean
percentage error (MPE) of the force. The trainings are those of commit 0edfa76; the JSON has their
commands, errors of the judged runs after the last step, and errors on validation on the way.
"""

import numpy as np

from pca_tools import files
from reports import markdown

# (scene, method) -> soil, 1e-4 m²; MPE of the force of each run, %
PUBLISHED = {
    ('blade', 'full graph'): (0.60, (4.5, -5.3, 0.3, -10.5, 11.6, -2.4, -17.2, -1.9, -5.1)),
    ('blade', 'partial graph'): (
        0.025, (-62.7, -30.9, -1.6, 397.2, 82.1, -28.3, -69.3, -179.3, -54.0),
    ),
    ('wheel', 'full graph'): (0.03, (10.9, -16.2, -18.5, -22.8, -21.7, -5.1, 0.2, 26.6, -31.0)),
    ('wheel', 'partial graph'): (
        0.018, (-13.1, -90.0, 111.7, 24.9, -78.8, 233.4, -22.3, 111.7, -142.8),
    ),
}  # fmt: skip
NAMES = {'fcg_original': 'full graph', 'pcg_thesis': 'partial graph', 'pcg': '`pcg`'}


def table(path: str) -> str:
    """Soil and force errors, published and reached; of those reached also the smallest and largest
    on validation at the steps that were looked at."""
    lines: list[tuple] = []
    for scene in ('blade', 'wheel'):
        for (of, name), (soil, mpe) in PUBLISHED.items():
            if of == scene:
                lines.append((f'{scene}, published (9)', name, '', soil, '', _size(mpe)))
        for row in files.read_json(path)['rows']:
            if row['scene'] != scene:
                continue
            looks = row.get('validation')  # persistence is not trained
            lines.append((
                f'{scene}, {row["runs"]} ({len(row["soil_mse"])})',
                NAMES.get(row['method'], row['method']),
                looks['step'][-1] if looks else '',
                1e4 * float(np.mean(row['soil_mse'])),
                _span(1e4 * np.array(looks['soil_mse'])) if looks else '',
                _size(row['force_mpe']),
                _span(np.sqrt(looks['force_mse'])) if looks else '',
            ))  # fmt: skip
    header = ('runs', 'method', 'steps', 'soil, 1e-4 m²', 'on the way', 'force, size of the MPE, %',
              'on the way, RMS, N')  # fmt: skip
    return markdown.table(header, lines)


def _size(percentages):
    return float(np.mean(np.abs(percentages)))


def _span(values):
    return f'{markdown.cell(float(min(values)))} to {markdown.cell(float(max(values)))}'
