"""Writes a trained model as SavedModel, LiteRT or ONNX, as a C project, an FMU or a page.

Examples:
  lts export --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation --output_path=/tmp/exported

  # small runtimes; need the extra: pip install -e .[deploy]
  lts export --format=tflite --model_path=... --data_path=... \\
      --output_path=...

  # C99 source, or an FMU of FMI 2.0; see docs/native.md
  lts export --format=c --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation --output_path=/tmp/soil

  # an FMU of two blades on one terrain
  lts export --format=fmu --n_tools=2 --output_path=/tmp/blades \\
      --model_path=models/excavation/soil_field --data_path=datasets/excavation

  # one HTML file with a soil field inside, which needs no server; a recorded run beside is optional
  lts export --format=page --model_path=excavation \\
      --data_path=datasets/excavation --output_path=blade.html
"""

from absl import flags

from learning_to_simulate import command, shipped
from learning_to_simulate.export.exporting import FORMATS, export, summary


def define_flags() -> None:
    flags.DEFINE_string(
        'model_path', None, 'Trained model: a path or a shipped name.', required=True
    )
    flags.DEFINE_string('data_path', None, 'Dataset folder of the model; a page needs none.')
    flags.DEFINE_string(
        'output_path', None, 'Folder (page: file) to write; absent or empty.', required=True
    )
    flags.DEFINE_enum('format', 'savedmodel', [*FORMATS, 'page'], 'What to write.')
    flags.DEFINE_integer('n_tools', None, 'Tools on the terrain of a soil field as an FMU.', 1)


def run(values) -> None:
    if values.format == 'page':
        from learning_to_simulate.native import web_page

        web_page.export(values.model_path, values.output_path, values.data_path)
        return
    if values.data_path is None:
        raise ValueError(f'--data_path is missing: --format={values.format} is compared on it')
    model = shipped.find(values.model_path, 'models')
    data = shipped.find(values.data_path, 'datasets')
    command.import_tensorflow()
    description = export(model, data, values.output_path, values.format, values.n_tools)
    print(summary(description, values.output_path))


if __name__ == '__main__':
    define_flags()
    command.start(run)
