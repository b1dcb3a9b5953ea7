"""The cases of `run_scripts.stability_report`, one file per part of the project."""
