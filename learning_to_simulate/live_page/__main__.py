"""A model in the browser: move the tool, see soil, force and status at 60 frames a second.

Examples:
  python -m learning_to_simulate.live_page                       # the blade; lts live
  python -m learning_to_simulate.live_page --model=wheel --port=8081
  python -m learning_to_simulate.live_page --model=my_model --data_path=my_data

Then open http://localhost:8080. Needs the extra `live`: pip install -c constraints.txt -e .[live]
"""

import importlib.util
import os
import socket

from absl import flags

from learning_to_simulate import command, shipped


def check_door(host: str, port: int) -> None:
    """Sees that the page can be made, and its port listened at; viser would take the next one.

    Raises:
      ValueError: it cannot, with what to do.
    """
    if importlib.util.find_spec('viser') is None:
        raise ValueError('viser is not installed: pip install -c constraints.txt -e .[live]')
    try:
        with socket.create_server((host, port)):
            pass
    except (OSError, OverflowError) as error:
        raise ValueError(
            f'port {port} of {host} cannot be listened at ({error}); name another: --port=8081'
        ) from error


def model_names() -> list[str]:
    """Names of the shipped models that can be stepped live."""
    from learning_to_simulate import registry

    return [n for n in shipped.names() if registry.of_folder(shipped.find(n, 'models')).steps]


def session_of(name: str, data_path: str | None = None):
    """A session of a model, with the solver's runs where a dataset of it is there.

    Raises:
      FileNotFoundError, ValueError: no such model; a named dataset that does not fit.
    """
    from learning_to_simulate import api
    from learning_to_simulate.live_page import recorded, session

    model = api.load(name)
    return session.Session(model, recorded.of_model(model, data_path))


def run(values) -> None:
    """Runs the command with its flags."""
    # A shipped model goes by its place in models/, whichever way it was named.
    path = os.path.relpath(shipped.find(values.model, 'models'), shipped.folder('models'))
    check_door(values.host, values.port)
    command.import_tensorflow(num_threads=1)
    from learning_to_simulate.live_page.page import Page

    names = model_names()
    first = path if path in names else values.model
    page = Page(
        lambda name: session_of(name, values.data_path if name == first else None),
        names if first in names else [first, *names],
        first,
        values.host,
        values.port,
    )
    print(f'live page: http://{values.host}:{values.port} shows {first}; Ctrl+C ends', flush=True)
    try:
        page.run()
    except KeyboardInterrupt:
        print('ended')
    finally:
        page.stop()


if __name__ == '__main__':
    flags.DEFINE_string('model', 'excavation_v2', 'Model folder, or a shipped model by name.')
    flags.DEFINE_string('data_path', None, 'Dataset with runs to follow; default: the shipped one.')
    flags.DEFINE_string('host', 'localhost', 'Address to listen at; 0.0.0.0 for all of a network.')
    flags.DEFINE_integer('port', 8080, 'Port to listen at.', 1, 65535)
    command.start(run)
