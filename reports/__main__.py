"""Runs a report by its name.

python -m reports                          # the list
python -m reports rollout_time --help      # what one does, its flags, examples
python -m reports rollout_time --data_path=datasets/excavation
"""

import runpy
import sys

# Name -> module, and what it answers.
REPORTS = {
    'results_table': ('results_table', 'errors of the shipped models beside the trivial ones'),
    'protocol': ('protocol', 'methods judged per run, over seeds, against all baselines'),
    'paper_tables': ('paper_tables', "the thesis' tables with ours beside them"),
    'compare_forces': ('compare_forces', "solver's forces beside the published records"),
    'published_physics': ('published_physics', "the blade's force with the published physics"),
    'solver_sweeps': ('solver_sweeps', "what the solver's own parameters change"),
    'solver_pictures': ('solver_pictures', 'leak and force spectrum of two raw runs, drawn'),
    'solver_speed': ('solver_speed', 'CPU seconds of the solver and of another checkout of it'),
    'film_strips': ('film_strips', 'one raw run of each kind as a strip of frames'),
    'error_vs_runtime': ('work_precision.report', 'error against run time: table, pictures'),
    'coarse_solver': ('work_precision.coarse_solver', 'the solver itself on coarser grids'),
    'rollout_time': ('speed.rollout_time', 'milliseconds per step of whole rollouts'),
    'step_latency': ('speed.step_latency', 'milliseconds of one live step'),
    'training_speed': ('speed.training_speed', 'samples per second, seconds to an error'),
    'swept_field': ('swept_field', 'a swept field per run: errors, rates, restarts, ten lengths'),
    'free_tool': ('free_tool', 'force in the air, starts in contact, stops, soil inside the tool'),
    'training_curve': ('training_curve', 'valid against training steps: is a training flat?'),
    'cross_validation': ('cross_validation', 'a dozen runs: each judged by models without it'),
    'learning_curve': ('learning_curve', 'errors against the number of training runs'),
    'reliability': ('reliability_curves', 'errors of frames against promised bounds'),
    'driven_times': ('driven_times', 'error against time on driven runs: table, picture'),
    'driving': ('driving', 'free driving: what the modes allow, errors by kind of path'),
    'torque': ('torque', 'torque beside force of models in a subspace'),
    'explain': ('speed.explain', 'what a rollout leaves out: edges, MFLOP, time'),
    'edge_ablation': ('edges.edge_ablation', 'what edges between modes are worth'),
    'nri_stability': ('edges.nri_stability', 'how far seeds of NRI agree'),
    'nri_proof': ('edges.nri_proof', 'edges of known systems, found without labels'),
    'nri_stiffness': ('edges.nri_stiffness', 'springs up to the limit of the integrator'),
    'stability_report': ('stability.report', 'stiff and extreme cases, as experiments'),
    'scenes': ('scenes.report', 'scenes of every kind: data, error, time, weights, edges'),
    'scene_forms': ('scenes.forms', 'the models of those scenes in C and LiteRT, timed or refused'),
    'documents': ('documents', 'tables of the documents, again from their JSON'),
    'fuzz': ('fuzz.report', 'damaged and forged files to every reader'),
    'kills': ('fuzz.kills', 'SIGKILL at every point where something is written'),
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
