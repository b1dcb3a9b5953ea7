"""A model of a tool of one's own, from its outline to C, in one command.

Examples:
    lts new-tool bucket.json --output_path=bucket
    lts new-tool bucket.json --output_path=bucket --runs=48 --num_processes=16
    lts new-tool bucket.json --output_path=/shared/bucket --cluster=slurm:48

The outline is that of `mpm/bodies.py`. Runs of the solver with that tool (`mpm.generate`) become a
dataset (`pca_tools.convert`); a soil field is trained on it, from the weights of a shipped one. A
network that does not improve on validation runs keeps its shipped weights. Both are judged on runs
that were kept back. The new one is taken where the product of its errors of soil and force is
smaller there, else the shipped one; that is written in `--formats`.

    raw/  data/  model/  judged/  judged_as_it_is/  c/  fmu/  page.html  new_tool.json

Each step is a command of its own, that goes on where it stopped: so does this one, given again. Of
the runs, as many as are kept back may fail.
"""

import json
import math
import os
import shutil
import subprocess
import sys
import time

from absl import flags

from mpm import bodies, raw_run, scenes
from mpm.motions import catalogue
from pca_tools import command, files
from pca_tools.storage.folder_lock import locked

FIRST_SEED = 9000  # nobody has seen these (`splits.RUNS`)
KINDS = {
    'plate': 'smooth,stops,reverse,lift', 'bucket': 'scoop,smooth,scoop,lift,scoop,reverse',
    'wheel': 'slip,stops,reverse,load',
}  # fmt: skip
WIDE = 0.5  # m; wider tools need the wide bin
STATE = 'new_tool.json'
ERRORS = ('soil_mm', 'force_relative_l2')
FORMATS = ['c', 'fmu', 'page']


class Work:
    """A tool's folder, made if absent, and what was done in it; `asked` is what the model is made
    of, JSON-compatible. ValueError: a folder of something else, or of another tool or other
    settings."""

    def __init__(self, path: str, asked: dict):
        self.path, self._file = path, os.path.join(path, STATE)
        self.state: dict = {'asked': asked, 'seconds': {}}
        if os.path.exists(self._file):
            self.state = files.read_json(self._file)
            # JSON may write a number in another way.
            there, now = self.state.get('asked', {}), json.loads(json.dumps(asked))
            other = sorted(name for name in now if there.get(name) != now[name])
            if other:
                raise ValueError(
                    f'{path}: was begun with another {", ".join(other)}; give another '
                    f'--output_path (its raw/ may be copied there to keep the runs)'
                )
        elif os.path.isdir(path) and set(os.listdir(path)) - {'raw'}:
            raise ValueError(f'{path}: holds something else; give another --output_path')
        os.makedirs(path, exist_ok=True)
        self.save()

    def save(self) -> None:
        files.write_json(self._file, self.state)

    def at(self, *names: str) -> str:
        return os.path.join(self.path, *names)

    def do(self, step: str, module: str, *arguments: str) -> None:
        """Runs a command to its end; its time is kept, of a part as well. ValueError: it failed,
        and has said why; SystemExit: Ctrl-C."""
        print(f'--- {step}: python -m {module} {" ".join(arguments)}', flush=True)
        started = time.monotonic()
        # It ends with this process, however that one ends: it would hold its folder.
        parent = [sys.executable, '-m', 'pca_tools.storage.parent', str(os.getpid())]
        child = subprocess.Popen([*parent, module, *arguments])
        try:
            code = child.wait()
        except KeyboardInterrupt:  # the command has it as well, and saves what it has
            child.wait()
            sys.exit('stopped; the same command goes on')
        finally:
            seconds = self.state['seconds']
            seconds[step] = seconds.get(step, 0.0) + time.monotonic() - started
            self.save()
        if code:
            raise ValueError(f'{step} failed, see above; the same command goes on from there')


def planned(tool: dict, count: int) -> tuple[scenes.Scene, str, list[str]]:
    """The scene, the kinds and the ids of the runs of a tool, all checked (ValueError)."""
    from mpm import run  # help does not wait for Numba
    from mpm.simulation import Settings

    name = 'wheel' if 'radius' in tool else 'bucket' if len(tool['outline']) > 2 else 'plate'
    scene = scenes.SCENES['wheel' if name == 'wheel' else 'excavation']
    is_wide = name != 'wheel' and tool['width'] > WIDE
    kinds = 'tools' if is_wide else KINDS[name]
    cases = catalogue.select_seeds(scene, f'{FIRST_SEED}-{FIRST_SEED + count - 1}', kinds)
    for case in cases:
        run.prepared(catalogue.in_bin(scene, case), case, Settings(), tool)
    return scene, kinds, list(cases)


def made_of(raw: str, cases: list[str]) -> list[str]:
    """Those of some runs that a folder holds."""
    manifest = raw_run.read_manifest(raw) or {'runs': []}
    made = {run['case'] for run in manifest['runs']}
    return [case for case in cases if case in made]


def errors(work: Work) -> list[tuple[float, str]]:
    """Of the trained and of the shipped model: the product of the errors of soil and force,
    infinite of one that refused, and both errors in words."""
    found = []
    for folder in ('judged', 'judged_as_it_is'):
        mean = files.read_json(work.at(folder, 'metrics.json'))['mean']['model']
        soil, force = (mean.get(name) for name in ERRORS)
        if soil is None or force is None:
            found.append((math.inf, 'refused some of them'))
        else:
            found.append((soil * force, f'soil {soil:.2f} mm, force {force:.3f}'))
    return found


def is_taken(work: Work) -> bool:
    """Whether the trained model is taken: the product of its errors is less."""
    (own, _), (usual, _) = errors(work)
    return own < usual


def verdict(work: Work, kept: int, where: str) -> str:
    """The last line: what was taken, the errors of both on the runs kept back, time."""
    (_, own), (_, usual) = errors(work)
    both = (own, f'shipped model as it is: {usual}')
    if not is_taken(work):
        both = (f'shipped model as it is, {usual}', f'trained, not taken: {own}; make more --runs')
    hours, minutes = divmod(round(sum(work.state['seconds'].values()) / 60), 60)
    taken = f'{hours} h {minutes} min' if hours else f'{minutes} min'
    page = '' if os.path.exists(work.at('page.html')) else '; no page'
    return f'{both[0]} on {kept} runs kept back; {both[1]}; {taken} on {where}{page}'


def main(values, arguments) -> None:
    if len(arguments) != 1:
        raise ValueError('one JSON file of a tool was expected (mpm/README.md)')
    tool, count, kept = bodies.read_tool(arguments[0]), values.runs, values.kept
    kept = kept or max(count // 6, 1)
    if count - 2 * kept < 1:
        raise ValueError(
            f'of {count} runs {kept} are kept back and {kept} validate: none is left to learn from'
        )
    scene, kinds, cases = planned(tool, count)
    first = folder_of(values.initial_weights or scene.name)
    asked = {
        'tool': tool, 'runs': count, 'kept': kept, 'kinds': kinds, 'initial_weights': first,
        'num_steps': values.num_steps, 'learning_rate': values.learning_rate,
    }  # fmt: skip
    lts = 'learning_to_simulate.'
    work = Work(values.output_path, asked)
    with locked(work.path):
        tool_file = work.at('tool.json')
        files.write_json(tool_file, tool)
        data, model = f'--data_path={work.at("data")}', f'--model_path={work.at("model")}'
        inside = catalogue.bin_name(scene, cases[0])
        raw = work.at('raw', *filter(None, [inside]))
        try:
            work.do(
                '1 of 5, runs of the solver', 'mpm.generate', f'--scene={scene.name}',
                f'--operator_seeds={FIRST_SEED}-{FIRST_SEED + count - 1}', f'--kinds={kinds}',
                f'--tool={tool_file}', f'--output_path={work.at("raw")}',
                f'--num_processes={values.num_processes}', f'--cluster={values.cluster}',
            )  # fmt: skip
        except ValueError:  # a motion that the solver cannot follow must not stop all others
            made = made_of(raw, cases)
            if len(made) < count - kept or len(made) <= 2 * kept:
                raise
            print(f'goes on with {len(made)} of {count} runs', flush=True)
            cases, count = made, len(made)
        if not os.path.exists(work.at('data', 'metadata.json')):
            # Runs of all kinds are kept back, and as many validate.
            share = kept / count
            work.do(
                '2 of 5, dataset', 'pca_tools.convert', f'--raw_path={raw}',
                f'--output_path={work.at("data")}', f'--hold_out={",".join(cases[-kept:])}',
                f'--split={1 - 2 * share!r},{share!r},{share!r}', '--frame_stride=4',
            )  # fmt: skip
        if not os.path.exists(work.at('model', 'config.json')):
            work.do(
                '3 of 5, training', lts + 'train', '--model=soil_field', data, model,
                f'--initial_weights={first}', f'--num_steps={values.num_steps}',
                f'--set=learning_rate={values.learning_rate}',
            )  # fmt: skip
        for name, of in (('judged', model), ('judged_as_it_is', f'--model_path={first}')):
            if not os.path.exists(work.at(name, 'metrics.json')):
                work.do(
                    f'4 of 5, runs kept back, {name}', lts + 'train', '--mode=eval_rollout', data,
                    of, f'--output_path={work.at(name)}',
                )  # fmt: skip
        taken = model if is_taken(work) else f'--model_path={first}'
        for kind in values.formats:
            name = 'page.html' if kind == 'page' else kind
            if os.path.exists(work.at(name) if kind == 'page' else work.at(name, 'export.json')):
                continue
            shutil.rmtree(work.at(name), ignore_errors=True)  # what a killed step left
            try:
                work.do(
                    f'5 of 5, {kind}', lts + 'export', f'--format={kind}', data, taken,
                    f'--output_path={work.at(name)}',
                )  # fmt: skip
            except ValueError:
                if kind != 'page':  # which needs a compiler for WebAssembly
                    raise
        where = values.cluster or f'{values.num_processes} processes'
        work.state['verdict'] = verdict(work, kept, where)
        work.save()
    print(work.state['verdict'])


def folder_of(model: str) -> str:
    """The folder of a model that is named by its path, or by its name among those that ship
    (ValueError)."""
    code = 'import sys; from learning_to_simulate import shipped as s; print(s.find(*sys.argv[1:]))'
    command_line = [sys.executable, '-c', code, model, 'models']
    done = subprocess.run(command_line, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(done.stderr.strip().splitlines()[-1].partition(': ')[2])
    return done.stdout.strip()


if __name__ == '__main__':
    flags.DEFINE_string('output_path', None, 'Folder of all that is made.', required=True)
    flags.DEFINE_integer('runs', 24, 'Runs of the solver, about two minutes of one core each.', 2)
    flags.DEFINE_integer('kept', None, 'Kept back to judge; as many validate. Default: a sixth.', 1)
    flags.DEFINE_string('initial_weights', None, 'Model to start from; default: the shipped one.')
    flags.DEFINE_integer('num_steps', 2000, 'Training steps of the load.', 1)
    flags.DEFINE_float('learning_rate', 1e-3, 'The first one.')
    flags.DEFINE_integer('num_processes', 2, 'Runs of the solver at a time.', 1)
    flags.DEFINE_multi_enum(
        'formats', FORMATS, FORMATS, 'What the model is written as; given again for each.'
    )
    flags.DEFINE_string('cluster', '', 'Where runs are made: local:4, slurm:64, tcp://host:port.')
    command.start(main, n_argument=1)
