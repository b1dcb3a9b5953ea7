"""Holds the arrows between the folders: who may import whom, and what must stay unloaded.

Two views: the source text (every `import`, also those inside functions) and a fresh interpreter
(what an import really pulls in).
"""

import ast
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PACKAGES = (
    'learning_to_simulate',
    'mpm',
    'nri',
    'pca_tools',
    'reports',
    'run_scripts',
)
MAX_LINES = 800
UNPICKLERS = ('legacy_pickles.py',)  # the restricted reader of the authors' arrays

# Folder -> project modules it may import beside its own. Only `run_scripts` may import all.
MAY_IMPORT = {
    'mpm': (
        'pca_tools.command',
        'pca_tools.files',
        'pca_tools.raw_runs',
        'pca_tools.storage',
        'pca_tools.workers',
    ),
    'pca_tools': (),
    'learning_to_simulate': ('pca_tools',),
    'nri': (
        'pca_tools',
        'learning_to_simulate.checkpoints',
        'learning_to_simulate.command',
        'learning_to_simulate.config',
        'learning_to_simulate.subspace.edge_lists',
    ),
    'reports': ('learning_to_simulate', 'mpm', 'nri', 'pca_tools'),
}
# The main package from the ground up: a module imports those of its own line and of lines above,
# inside functions too. The longest name that fits says which line a module is on.
LAYERS = (
    ('_version', 'command', 'scene', 'metrics', 'config',
     'soil_truth', 'rendering', 'shipped', 'error_bound', 'axes', 'swept', 'bed', 'live.poses'),
    ('render_rollout', 'connectivity_utils', 'reading_utils', 'normalization', 'checkpoints',
     'registry'),
    ('subspace', 'rollout_status', 'rollout', 'evaluation', 'training', 'live'),
    ('soil_field', 'baselines', 'full_space', 'subspace.method', 'presets'),
    ('export', 'native'),
    ('soil_field.stepper', 'soil_field.loaded', 'soil_field.rollout', 'soil_field.evaluation',
     'soil_field.method'),
    ('api', 'train', 'live.roll_out_path', 'soil_field.fit_soil', 'mujoco_soil'),
    ('native.web_page', 'export.__main__', 'cli'),
)  # fmt: skip
# Outside package -> the only files (or folders) of the project that may name it. `reports` and
# `run_scripts` are free, tests too.
ONLY_IN = {
    'tensorflow': ('learning_to_simulate/', 'nri/', 'pca_tools/tfrecord_io.py'),
    'sonnet': ('learning_to_simulate/', 'nri/'),
    'sklearn': ('learning_to_simulate/', 'pca_tools/'),
    'graph_nets': ('learning_to_simulate/subspace/graph_network.py',),
    'pickle': ('pca_tools/legacy_pickles.py',),
    'dill': (),
    'joblib': (),
    'cloudpickle': (),
    'distributed': ('pca_tools/workers.py',),
    'dask': ('pca_tools/workers.py',),
    'mujoco': ('learning_to_simulate/mujoco_soil.py',),
    'dask_jobqueue': ('pca_tools/workers.py',),
    'h5py': ('pca_tools/formats/lagrangebench.py',),
    'vtk': ('pca_tools/formats/vtp_files.py',),
}
# Modules -> packages that they must import without. (Keras loads scikit-learn and matplotlib where
# they are installed, so a look at what is loaded afterwards would blame the wrong one.)
IMPORTS_WITHOUT = [
    (
        (
            'pca_tools.storage.whole_files',
            'pca_tools.storage.folder_lock',
            'pca_tools.storage.parent',
            'pca_tools.command',
        ),
        ('numpy', 'mpm'),
    ),
    (
        ('pca_tools.subspace', 'pca_tools.rigid_fit', 'pca_tools.convert', 'pca_tools.inspect'),
        ('tensorflow', 'matplotlib'),
    ),
    (
        ('mpm.run', 'mpm.scenes', 'mpm.solver'),
        ('tensorflow', 'sklearn', 'pca_tools.subspace', 'pca_tools.convert'),
    ),
    (  # what a live step loads: a third of the time to the first frame is saved so
        (
            'learning_to_simulate.subspace.method',
            'learning_to_simulate.live.stepper',
            'learning_to_simulate.native.engines',
        ),
        ('keras', 'scipy', 'sklearn', 'matplotlib', 'imageio_ffmpeg', 'numba', 'mpm', 'nri'),
    ),
    (
        (
            'learning_to_simulate.baselines.path_ridge',
            'learning_to_simulate.baselines.earthmoving',
            'learning_to_simulate.baselines.wheel_terramechanics',
            'learning_to_simulate.subspace.path_memory',
            'learning_to_simulate.bed',
        ),
        ('tensorflow', 'sonnet', 'sklearn', 'mpm'),
    ),
    (
        ('learning_to_simulate.render_rollout',),
        ('tensorflow', 'matplotlib', 'imageio_ffmpeg', 'PIL'),
    ),
]

# Tests of something that goes through several modules, or that are no Python.
TESTS_OF_NO_ONE_MODULE = {
    'learning_to_simulate/native/test_c_faults.py',
    'learning_to_simulate/native/test_ros2_node.py',
    'learning_to_simulate/soil_field/test_shipped_fields.py',
    'learning_to_simulate/subspace/test_changing_context.py',
    'learning_to_simulate/subspace/test_left_out.py',
    'learning_to_simulate/subspace/test_numerics.py',
    'learning_to_simulate/subspace/test_several_bodies.py',
    'mpm/motions/test_data_of_record.py',
    'reports/test_main.py',
}  # fmt: skip


def source_files():
    """All Python files of the project, tests included."""
    folders = (*PACKAGES, 'tests')
    return sorted(p for folder in folders for p in (ROOT / folder).rglob('*.py'))


def package_files():
    """All Python files of the packages, as paths relative to the root."""
    paths = [path.relative_to(ROOT) for path in source_files()]
    return [path for path in paths if path.parts[0] != 'tests']


def imported_names(path):
    """Yields (dotted name, line) of everything that a file imports, at any depth."""
    package = path.parent.parts
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            parts = (*base, *filter(None, [node.module]))
            yield from (('.'.join((*parts, alias.name)), node.lineno) for alias in node.names)


def is_within(name, module):
    return name == module or name.startswith(module + '.')


def test_imports_follow_the_arrows():
    wrong = []
    for path in package_files():
        folder, name_of_file = path.parts[0], path.as_posix()
        for name, line in imported_names(path):
            top, allowed = name.split('.')[0], MAY_IMPORT.get(folder)
            if (
                allowed is not None
                and top in PACKAGES
                and top != folder
                and not any(is_within(name, module) for module in allowed)
            ):
                wrong.append(f'{path}:{line} imports {name}; {folder} may import {allowed}')
            places = ONLY_IN.get(top, ('',)) if folder not in ('reports', 'run_scripts') else ('',)
            if not name_of_file.startswith(places):
                wrong.append(f'{path}:{line} imports {name}; only {places} may')
    assert not wrong, '\n'.join(wrong)


def own_imports(package='learning_to_simulate'):
    """Module of a package -> those of it that it imports, without the package's name."""
    files = [path for path in package_files() if path.parts[0] == package]
    names = {'.'.join(p.with_suffix('').parts[1:]).removesuffix('.__init__'): p for p in files}
    found = {}
    for name, path in names.items():
        found[name] = set()
        for imported, _ in imported_names(path):
            parts = imported.split('.')[1:] if is_within(imported, package) else []
            while parts and '.'.join(parts) not in names:
                parts.pop()
            found[name] |= {'.'.join(parts)} - {name, ''}
    return found


def layer_of(module):
    fits = [(len(n), i) for i, line in enumerate(LAYERS) for n in line if is_within(module, n)]
    assert fits, f'learning_to_simulate.{module} is on no line of LAYERS'
    return max(fits)[1]


def test_no_arrow_of_the_main_package_climbs():
    imports = own_imports()
    assert 'config' in imports['presets'] and 'evaluation' in imports['train']  # it sees
    climbs = [
        f'{name} imports {other}'
        for name in imports.keys() - {'__init__'}
        for other in imports[name]
        if layer_of(other) > layer_of(name)
    ]
    assert not climbs, f'LAYERS says who lies above whom: {climbs}'


@pytest.mark.parametrize('package', PACKAGES)
def test_no_circle_in_a_package(package):
    """Modules that import none of the rest are taken away until none is left."""
    left = own_imports(package)
    while free := {name for name, others in left.items() if not others & left.keys()}:
        left = {name: others for name, others in left.items() if name not in free}
    assert not left, f'these import each other: {sorted(left)}'


def test_tests_mirror_the_sources():
    """A test file lies where its module lies; a test of several modules is in the list."""
    alone = set()
    for package in PACKAGES:
        for path in (ROOT / 'tests' / package).rglob('test_*.py'):
            place = path.relative_to(ROOT / 'tests')
            module = ROOT / place.with_name(path.stem.removeprefix('test_'))
            if not (module.is_dir() or module.with_suffix('.py').exists()):
                alone.add(place.as_posix())
    assert alone == TESTS_OF_NO_ONE_MODULE


def test_the_scan_sees_imports_inside_functions():
    names = {name for name, _ in imported_names(pathlib.Path('pca_tools/tfrecord_io.py'))}
    assert 'tensorflow' in names


def test_files_are_short_and_load_no_pickle():
    wrong = []
    for path in source_files():
        text = path.read_text(encoding='utf-8')
        if (lines := text.count('\n')) > MAX_LINES:
            wrong.append(f'{path} has {lines} lines, split it by idea')
        for node in ast.walk(ast.parse(text)):
            if (
                path.name not in UNPICKLERS
                and isinstance(node, ast.Attribute)
                and node.attr in ('load', 'loads', 'Unpickler')
                and isinstance(node.value, ast.Name)
                and node.value.id in ('pickle', 'cloudpickle', 'dill')
            ):
                wrong.append(f'{path}:{node.lineno} loads a pickle')
            if not isinstance(node, ast.keyword) or node.arg != 'allow_pickle':
                continue
            if getattr(node.value, 'value', None) is not False:
                wrong.append(f'{path}:{node.value.lineno} lets numpy load pickles')
    assert not wrong, '\n'.join(wrong)


@pytest.mark.parametrize('modules, absent', IMPORTS_WITHOUT, ids=lambda names: '+'.join(names))
def test_imports_without(modules, absent):
    """A fresh interpreter in which `absent` cannot be imported."""
    code = f'import sys; sys.modules.update(dict.fromkeys({absent!r})); import {", ".join(modules)}'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f'{modules} need one of {absent}:\n{done.stderr}'
