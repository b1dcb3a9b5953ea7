"""The console command `lts`: every program of the project under one name.

lts train --data_path=datasets/excavation --model_path=my_model
lts evaluate --data_path=datasets/excavation --model_path=my_model --output_path=rollouts
lts rollout --model=excavation --poses=path.csv --output_path=dig.npz --picture=dig.gif
lts COMMAND --help        # flags and examples of one
"""

import runpy
import sys

from learning_to_simulate._version import __version__

# Name -> module, with flags that the name stands for, and what it does.
COMMANDS = {
    'list': ('learning_to_simulate.shipped', 'names of the models that ship'),
    'train': ('learning_to_simulate.train', 'trains a model, or goes on with its training'),
    'evaluate': (
        'learning_to_simulate.train --mode=eval_rollout',
        'rolls out a split: files and errors beside the trivial predictors',
    ),
    'fit-soil': (
        'learning_to_simulate.soil_field.fit_soil',
        'finds the friction angle and density of a soil from recorded digs',
    ),
    'rollout': ('learning_to_simulate.live.roll_out_path', 'rolls out a path from a file'),
    'render': ('learning_to_simulate.render_rollout', 'draws a rollout: PNG, GIF, MP4, VTP'),
    'live': ('learning_to_simulate.native.web_page', 'a soil field in the browser'),
    'export': (
        'learning_to_simulate.export',
        'writes a SavedModel, LiteRT or ONNX model, a C project, an FMU or a page',
    ),
    'new-tool': ('mpm.new_tool', 'a model of a tool of your own, from its outline to C'),
    'generate': ('mpm.generate', 'runs the solver: raw runs of a scene'),
    'import': ('pca_tools.import_data', "raw runs from other projects' data"),
    'export-data': ('pca_tools.export_data', 'a dataset or rollouts in their formats'),
    'convert': ('pca_tools.convert', 'raw runs -> dataset with its subspace'),
    'append': ('pca_tools.append', 'adds raw runs to a dataset, in its subspace'),
    'inspect': ('pca_tools.inspect', 'what is in a dataset, and what is wrong with it'),
    'modes': ('pca_tools.plot_modes', 'draws a subspace: energy, errors, modes'),
}


def main() -> None:
    name, *rest = sys.argv[1:] or ['--help']
    if name in ('-h', '--help', 'help'):
        print(__doc__)
        for known, (_, about) in COMMANDS.items():
            print(f'  {known:10s} {about}')
        return
    if name == '--version':
        print(__version__)
        return
    if name not in COMMANDS:
        sys.exit(f'error: no command {name!r}; there are {", ".join(COMMANDS)}')
    module, *implied = COMMANDS[name][0].split()
    sys.argv[1:] = implied + rest
    try:
        runpy.run_module(module, run_name='__main__', alter_sys=True)
    except ModuleNotFoundError as error:
        sys.exit(f'error: lts {name} needs {error.name}, which is not installed')


if __name__ == '__main__':
    main()
