"""Runs a report by its name.

python -m reports                                  # the list
python -m reports protocol --help                  # what one does, its flags, examples
python -m reports explain --model_path=models/wheel/pcg --data_path=datasets/wheel
"""

import runpy
import sys

# Name -> module, and what it answers.
REPORTS = {
    'protocol': ('protocol', 'methods judged run by run, against baselines and the truth'),
    'times': ('times', 'error against run time: table, picture'),
    'machines': ('machines', 'recorded machines in MuJoCo against the solver; stability, speed'),
    'stability': ('stability', 'extreme cases: what holds, is flagged, is refused'),
    'beyond': ('beyond', 'runs that leave the data, and whether the status says so'),
    'soil_fits': ('soil_fits', 'how well `lts fit-soil` finds known soils'),
    'explain': ('explain', 'what a rollout leaves out: edges, MFLOP, time'),
    'edges': ('edges.edge_ablation', 'what edges between modes are worth'),
    'nri_proof': ('edges.nri_proof', 'edges of known systems, found without labels'),
    'nri_stability': ('edges.nri_stability', 'how far seeds of NRI agree'),
    'documents': ('documents', 'tables of the documents, again from their JSON'),
}


def run(name: str) -> None:
    """Runs the report `name` as the main program, with the flags in `sys.argv`."""
    runpy.run_module(f'reports.{REPORTS[name][0]}', run_name='__main__', alter_sys=True)


def main(arguments: list[str]) -> None:
    """Runs `arguments[0]` with the flags that follow, or prints the list.

    Raises:
        SystemExit: no report of that name.
    """
    if not arguments or arguments[0] in ('-h', '--help', '--helpshort', '--helpfull'):
        print(__doc__)
        for name, (_, what) in REPORTS.items():
            print(f'  {name:18}{what}')
        return
    if arguments[0] not in REPORTS:
        sys.exit(f'error: no report {arguments[0]!r}; there are {", ".join(REPORTS)}')
    sys.argv[1:] = arguments[1:]
    run(arguments[0])


if __name__ == '__main__':
    main(sys.argv[1:])
