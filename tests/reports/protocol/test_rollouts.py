"""Flags of trainings, and what counts as trained."""

from pca_tools import files
from reports.protocol import rollouts


def test_trainings_differ_in_their_seed_where_anything_is_drawn():
    last = '--num_threads=1'
    assert rollouts.trainings('mlp', ['--modes=8'], 2, 'work/mlp') == {
        f'work/mlp_{i}': ['--preset=mlp', '--modes=8', f'--seed={i}', last] for i in (0, 1)
    }
    first, second = rollouts.trainings('pcg', ['--adjacency={seed}'], 2, '').values()
    assert (first[1], second[1]) == ('--adjacency=0', '--adjacency=1')
    # A regression draws nothing: it is trained once, and is given no seed, which it would refuse.
    assert rollouts.trainings('path_ridge', [], 2, 'r') == {'r_0': ['--preset=path_ridge', last]}


def test_what_is_fitted_at_once_is_trained_when_it_is_there(tmp_path):
    path = tmp_path / 'config.json'
    assert not rollouts._is_trained(str(tmp_path))
    files.write_json(str(path), {'config': {'preset': 'path_ridge'}})
    assert rollouts._is_trained(str(tmp_path))
    files.write_json(str(path), {'config': {'num_steps': 20}})
    assert not rollouts._is_trained(str(tmp_path))
    (tmp_path / 'ckpt-20.json').touch()
    assert rollouts._is_trained(str(tmp_path))


def test_other_runs_have_another_digest(tmp_path):
    for name, text in (('a', 'one'), ('b', 'two')):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'test.tfrecord').write_text(text)
    a, b = f'{tmp_path}/a', f'{tmp_path}/b'
    found = [rollouts.digest(path, 'test') for path in (a, b, f'{a},{b}', f'{b},{a}')]
    assert len(set(found)) == 4
    (tmp_path / 'b' / 'test.tfrecord').write_text('one')
    assert rollouts.digest(b, 'test') == found[0]
