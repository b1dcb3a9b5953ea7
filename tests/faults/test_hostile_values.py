"""Values that a user gives or a scene has: terminal control, forces that never change."""

import sys

import pytest
from absl import flags, logging

from learning_to_simulate import command


def test_a_command_cannot_be_made_to_control_the_terminal(monkeypatch):
    def fail(_):
        raise ValueError('no scene named \x1b[2J\x07' + 'x' * 30_000)

    monkeypatch.setattr(sys, 'argv', ['command'])
    with pytest.raises(SystemExit) as ended:
        command.start(fail)
    text = ended.value.code
    assert text.startswith('error: no scene named \\x1b[2J\\x07xxx') and len(text) < 5000


@pytest.mark.parametrize(('argument', 'level'), [('', logging.WARNING), ('-v=0', logging.INFO)])
def test_a_command_leaves_out_the_remarks_of_libraries_unless_asked(monkeypatch, argument, level):
    found = []
    monkeypatch.setattr(sys, 'argv', ['command', argument][: 1 + bool(argument)])
    before = logging.get_verbosity()
    try:
        with pytest.raises(SystemExit):
            command.start(lambda _: found.append(logging.get_verbosity()))
    finally:
        flags.FLAGS['verbosity'].unparse()
        logging.set_verbosity(before)
    assert found == [level]
