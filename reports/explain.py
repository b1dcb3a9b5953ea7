"""What a rollout saves: lists what it leaves out for its scene, and what each item is worth.

For every item: the edges, the MFLOP of a step (matrix products, counted in the traced graph or from
the shapes of the layers) and the weights that the rollout would have on top without it, and the
time of a step that it saves. To measure it, the item is switched off; all variants take turns after
a warm-up, and the median of the differences within a round counts. '-' stands where an item cannot
be switched alone, or where there is nothing to count. An item that changes what is computed (edges,
nodes) is switched with the weights as they are: they do not change the time.

Examples:
    python -m reports explain --model_path=models/excavation/pcg \\
        --data_path=datasets/excavation

    python -m reports explain --model_path=models/wheel/pcg --data_path=datasets/wheel \\
        --rounds=50 --output_path=/tmp/explain.json
"""

from absl import flags

from pca_tools import files
from reports import markdown, record


def table(values: dict) -> str:
    """The result of `explanation.Explanation.measure` as text."""
    head = (
        '{scene}, body {rigid_motion}: {nodes} nodes, {edges} edges, {weights} weights, '
        '{mflop_per_step:.3g} MFLOP and {us_per_step:.1f} us a step'.format(**values)
    )
    header = ('left out', 'edges', 'MFLOP', 'weights', 'us a step')
    keys = ('name', 'edges', 'mflop', 'weights', 'us_per_step')
    rows = [['-' if item[k] is None else item[k] for k in keys] for item in values['items']]
    return f'{head}\n\n{markdown.table(header, rows, aligned=True)}'


def define_flags() -> None:
    flags.DEFINE_string('model_path', None, 'Trained model.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset folder of the model.', required=True)
    flags.DEFINE_integer('rounds', 30, 'Timed rollouts of each variant.', 1)
    flags.DEFINE_string('output_path', None, 'JSON file for the items and all times.')


def main(values) -> None:
    import tensorflow as tf

    from reports.explanation import Explanation

    tf.get_logger().setLevel('ERROR')  # It takes the variants for one function, traced again.
    result = Explanation(values.model_path, values.data_path).measure(values.rounds)
    print(table(result))
    if values.output_path:
        files.write_json(values.output_path, record.provenance(1) | result)
