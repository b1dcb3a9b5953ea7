"""Measures the live page on the server's side: frames per second and CPU time of a frame.

Server, frame loop and model share one core; a client in another process reads what a browser
would. The recorded runs of the scene are followed, one after the other, with the solver's soil
beside them. CPU time is that of all threads of the server; it says what a quiet core can do, and
the frames per second what this machine did.

Example:
  python -m learning_to_simulate.live_page.benchmark --models=excavation,wheel --seconds=20
"""

import multiprocessing
import os
import time

from absl import flags

from learning_to_simulate import command
from pca_tools import files
from pca_tools.storage import markdown

WARM_UP = 1.0  # s


def watch(port: int, counts) -> None:
    """The client's process: `counts` [2] are the frames and bytes that came so far."""
    from learning_to_simulate.live_page.client import Client

    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    client = Client(port)
    while True:
        time.sleep(0.05)
        counts[0], counts[1] = client.frames, client.received


def measure(name: str, seconds: float, port: int) -> dict[str, float]:
    """Runs a page for some seconds.

    Args:
      name: of the model.
      seconds: s.
      port: to listen at.

    Returns:
      `frame_rate` and `received_rate`, 1/s; `cpu_ms` of a frame; `kilobytes` of a frame;
      `of_real_time`: frames per second over those of the model; `possible`: the same if the core
      had nothing else to do and no frame had to wait.

    Raises:
      FileNotFoundError, ValueError: no such model; a port in use; viser is missing.
    """
    from learning_to_simulate.live_page import session
    from learning_to_simulate.live_page.__main__ import free_port, require_viser, session_of

    require_viser()
    from learning_to_simulate.live_page.loop import FrameLoop
    from learning_to_simulate.live_page.page import Page

    free_port('localhost', port)
    page = Page(session_of, [name], name, port=port)
    runs = list(page.session.recorded.runs) if page.session.recorded else [None]
    turn = 0

    def frame():
        nonlocal turn
        if turn == 0 or page.session.moment.lamp == session.STOPPED:
            page.reset(runs[turn % len(runs)])
            turn += 1
        page.frame()

    context = multiprocessing.get_context('spawn')
    counts = context.Array('q', 2)
    client = context.Process(target=watch, args=(port, counts), daemon=True)
    client.start()
    while not page.server.get_clients():
        time.sleep(0.05)
    loop = FrameLoop(frame, page.session.scene.dt)
    loop.start()
    time.sleep(WARM_UP)
    before, cpu, start, seen = loop.frames, time.process_time(), time.monotonic(), list(counts)
    time.sleep(seconds)
    wall, cpu = time.monotonic() - start, time.process_time() - cpu
    frames, came = loop.frames - before, [b - a for a, b in zip(seen, counts)]
    loop.stop()
    client.terminate()
    page.stop()
    loop.wait()
    dt = page.session.scene.dt
    return {
        'frame_rate': frames / wall,
        'received_rate': came[0] / wall,
        'cpu_ms': 1e3 * cpu / frames,
        'kilobytes': came[1] / max(came[0], 1) / 1e3,
        'of_real_time': frames / wall * dt,
        'possible': frames / cpu * dt,
    }


def table(path: str) -> str:
    """The figures of a JSON file of this command as a table of Markdown."""
    return rows(files.read_json(path))


def rows(results: dict[str, dict[str, float]]) -> str:
    """The figures of `measure` by model as a table of Markdown."""
    columns = {
        'frames/s': 'frame_rate', 'of real time': 'of_real_time', 'received/s': 'received_rate',
        'kB a frame': 'kilobytes', 'CPU ms a frame': 'cpu_ms', 'possible': 'possible',
    }  # fmt: skip
    shares = ('of_real_time', 'possible')  # two digits behind the point
    lines = [
        (name, *(f'{row[key]:.2f}' if key in shares else f'{row[key]:.3g}'
                 for key in columns.values()))
        for name, row in results.items()
    ]  # fmt: skip
    return markdown.table(('model', *columns), lines)


def run(values) -> None:
    """Runs the command with its flags."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    command.import_tensorflow(num_threads=1)
    results = {}
    for name in values.models:
        print(f'measuring {name} for {values.seconds:g} s ...', flush=True)
        results[name] = measure(name, values.seconds, values.port)
    print(rows(results))
    if values.output:
        files.write_json(values.output, results)


if __name__ == '__main__':
    flags.DEFINE_list('models', ['excavation', 'wheel'], 'Models by name, or their folders.')
    flags.DEFINE_float('seconds', 20.0, 'Seconds of each.', 1.0)
    flags.DEFINE_integer('port', 8099, 'Port to listen at.')
    flags.DEFINE_string('output', None, 'JSON file for the figures.')
    command.start(run)
