"""Checks of a dataset folder and what its runs are like; `pca_tools.inspect` is the command."""

from pca_tools.inspection.records import inspect_folder as inspect_folder
