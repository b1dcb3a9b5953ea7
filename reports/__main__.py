"""Runs a report by its name.

python -m reports                                  # the list
python -m reports protocol --help                  # what one does, its flags, examples
python -m reports beyond --output_path=/tmp/beyond.json
"""

import importlib
import sys

from absl import flags

from learning_to_simulate import command

# Name -> module, and what it answers. A module has `define_flags`, `main`, and as docstring the
# text of its help.
REPORTS = {
    'protocol': ('protocol.report', 'methods judged run by run, against baselines and the truth'),
    'times': ('times', 'error against run time: table, picture'),
    'machines': ('machines', 'recorded machines in MuJoCo against the solver; stability, speed'),
    'stability': ('stability', 'extreme cases: what holds, is flagged, is refused'),
    'beyond': ('beyond', 'runs that leave the data, and whether the status says so'),
    'packing': ('packing', 'how much of an error is chance: runs with another packing'),
    'soil_fits': ('soil_fits', 'how well `lts fit-soil` finds known soils'),
    'page': ('page', 'how fast the page without a server is, in Chromium'),
    'nri_proof': ('edges.nri_proof', 'edges of known systems, found without labels'),
    'nri_stability': ('edges.nri_stability', 'how far seeds of NRI agree'),
    'documents': ('documents', 'tables of the documents, again from their JSON'),
}
# Run on one thread of TensorFlow: their times and bits are those of one.
ON_ONE_THREAD = 'times', 'stability', 'beyond', 'packing'


def main(arguments: list[str]) -> None:
    """Runs the report `arguments[0]` with the flags that follow, or prints the list."""
    if not arguments or arguments[0] in command.HELP:
        print(__doc__)
        for name, (_, what) in REPORTS.items():
            print(f'  {name:18}{what}')
        return
    name, *rest = arguments
    if name not in REPORTS:
        sys.exit(f'error: no report {name!r}; there are {", ".join(REPORTS)}')
    report = importlib.import_module(f'reports.{REPORTS[name][0]}')
    sys.argv = [f'reports {name}', *rest]
    report.define_flags()
    # So that help is that of the report.
    flags.adopt_module_key_flags(report)
    sys.modules['__main__'].__doc__ = report.__doc__

    def run(*given):
        if name in ON_ONE_THREAD:
            command.import_tensorflow(1)
        return report.main(*given)

    command.start(run, getattr(report, 'MOST_ARGUMENTS', 0))


if __name__ == '__main__':
    main(sys.argv[1:])
