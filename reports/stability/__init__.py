"""The cases of `reports stability_report`, one file per part of the project."""
