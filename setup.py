"""Installs the simulator, the solver and the tools.

    pip install -c constraints.txt -e .[cpu,viz,dev]

TensorFlow is left to an extra, `cpu` or `gpu`: the two wheels overwrite each other's files, so a
hard requirement would break one of the installs. `constraints.txt` pins the set that was tested.
"""

import pathlib
import re
import shutil

import setuptools
from setuptools.command.build_py import build_py

README = pathlib.Path(__file__).with_name('README.md')

VERSION = re.search(
    r"__version__ = '(.*)'",
    pathlib.Path(__file__).with_name('learning_to_simulate').joinpath('_version.py').read_text(),
)[1]

EXTRAS = {
    'cpu': ['tensorflow-cpu>=2.21,<2.22'],
    'gpu': ['tensorflow[and-cuda]>=2.21,<2.22'],
    'viz': ['imageio-ffmpeg>=0.6', 'matplotlib>=3.9', 'pillow>=11'],
    'deploy': ['ai-edge-litert>=2.0', 'onnx>=1.16', 'onnxruntime>=1.20', 'tf2onnx>=1.16'],
    'cluster': ['dask-jobqueue>=0.9', 'distributed>=2025.1'],
    'fmu': ['fmpy>=0.3.32'],
    'mujoco': ['mujoco>=4.0'],
    'page': ['ziglang>=0.14'],
    'vtk': ['vtk>=9.4'],
    'dev': ['mypy', 'playwright', 'pre-commit', 'pytest', 'pytest-xdist', 'ruff', 'zensical'],
}


class BuildWithModels(build_py):
    """Puts the shipped models into the package that is built: 8 MB, where `shipped.py` looks."""

    def run(self):
        """Copies the modules, then the models; an editable install finds these in the sources."""
        super().run()
        if not self.editable_mode:
            target = pathlib.Path(self.build_lib, 'learning_to_simulate', 'models')
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(pathlib.Path(__file__).with_name('models'), target)


setuptools.setup(
    name='learning-to-simulate-soil',
    version=VERSION,
    description='Graph-network simulation of granular soil driven by a rigid body',
    long_description=README.read_text(encoding='utf-8') if README.exists() else '',
    long_description_content_type='text/markdown',
    author='The learning_to_simulate_soil authors',
    license='Apache-2.0',
    license_files=['LICENSE'],
    classifiers=[
        'Intended Audience :: Science/Research',
        'Programming Language :: Python :: 3',
        'Topic :: Scientific/Engineering :: Physics',
    ],
    python_requires='>=3.11',
    # `reports`, `run_scripts` and `tests` serve who works on the sources; they are not installed.
    packages=setuptools.find_packages(
        include=[
            pattern
            for name in ('learning_to_simulate', 'mpm', 'nri', 'pca_tools')
            for pattern in (name, f'{name}.*')
        ]
    ),
    package_data={
        'learning_to_simulate': [f'**/*.{end}' for end in ('c', 'h', 'inc', 'in', 'js', 'css')]
    },
    cmdclass={'build_py': BuildWithModels},
    install_requires=[
        'absl-py>=2.1',
        'dm-sonnet>=2.0.2',
        'dm-tree>=0.1.9',
        'graph_nets>=1.1.0',
        'h5py>=3.11',
        'numba>=0.61',
        'numpy>=2.0',
        'scikit-learn>=1.5',
        'scipy>=1.14',
        'tensorboard>=2.20',
        'tqdm>=4.66',
    ],
    extras_require=EXTRAS,
    entry_points={'console_scripts': ['lts = learning_to_simulate.cli:main']},
)
