"""What commands share."""

import pytest

from learning_to_simulate import command


def test_paths_are_given_by_name():
    found = command.named_paths('beside', ['a=x', 'b=y=z'], 'FOLDER')
    assert found == {'a': 'x', 'b': 'y=z'}
    for bad in (['a'], ['=x'], ['a='], ['a=x', 'a=y']):
        with pytest.raises(ValueError, match='--beside=.*NAME=FOLDER was expected'):
            command.named_paths('beside', bad, 'FOLDER')
