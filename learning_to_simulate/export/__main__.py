"""Writes a trained model as SavedModel, LiteRT or ONNX, as a C project, an FMU or a page.

Examples:
  python -m learning_to_simulate.export --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation --output_path=/tmp/exported

  # small runtimes; need the extra: pip install -e .[deploy]
  python -m learning_to_simulate.export --format=tflite --model_path=... --data_path=... \\
      --output_path=...

  # the two networks of a swept field; see docs/native.md
  python -m learning_to_simulate.export --format=onnx --output_path=/tmp/field --n_particles=600 \\
      --model_path=models/excavation_v2/swept_field --data_path=datasets/excavation_v2

  # C99 source, or an FMU of FMI 2.0; see docs/native.md
  python -m learning_to_simulate.export --format=c --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation --output_path=/tmp/soil

  # one HTML file with the C library as WebAssembly inside, which needs no server
  python -m learning_to_simulate.export --format=page --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation --output_path=soil.html
"""

from absl import flags

from learning_to_simulate import command, native
from learning_to_simulate.export.exporting import FORMATS, export


def summary(description: dict, output_path: str) -> str:
    """What was written and how it compares, for the terminal."""
    compared = description['compared']
    apart = ', '.join(f'{k} {v:.2g}' for k, v in compared['relative_difference'].items())
    times = ', '.join(f'{name} {ms:.3g} ms' for name, ms in compared['ms_per_call'].items())
    return (
        f'wrote {output_path} ({description["format"]}, signatures '
        f'{", ".join(description["signatures"])})\n'
        f'largest difference to the source over {compared["calls"]} calls: {apart} (allowed '
        f'{compared["tolerance"]:g}), particles {compared["particles_difference_m"]:.2g} m\n'
        f'loaded in {description["load_s"]:.3g} s, then {times}'
    )


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('model_path', None, 'Trained model.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset folder of the model.', required=True)
    flags.DEFINE_string(
        'output_path', None, 'Folder (page: file) to write; absent or empty.', required=True
    )
    formats = [*FORMATS, *native.FORMATS, 'page']
    flags.DEFINE_enum('format', 'savedmodel', formats, 'What to write.')
    flags.DEFINE_integer('n_rigid', None, 'Rigid nodes of the graph; default: the largest.', 0)
    flags.DEFINE_integer(
        'n_particles', None, 'Particles of a swept field; default: all of its bed.', 1
    )


def run(values) -> None:
    """Runs the command with its flags.

    Raises:
      ValueError: see `export` and `native.exporting`.
    """
    if values.format == 'page':
        from learning_to_simulate.native import web_page

        web_page.run(values)
        return
    if values.format in native.FORMATS:
        _write_c(values)
        return
    command.import_tensorflow()
    description = export(
        values.model_path, values.data_path, values.output_path, values.format, values.n_rigid,
        values.n_particles,
    )  # fmt: skip
    print(summary(description, values.output_path))


def _write_c(values):
    if values.n_particles is not None:
        raise ValueError(f'--n_particles is not for --format={values.format}, which holds all')
    command.import_tensorflow()
    from learning_to_simulate.native import exporting

    given = values.model_path, values.data_path, values.output_path, values.format, values.n_rigid
    print(exporting.summary(exporting.export(*given), values.output_path))


if __name__ == '__main__':
    define_flags()
    command.start(run)
