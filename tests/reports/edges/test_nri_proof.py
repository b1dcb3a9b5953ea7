"""The proof of NRI, in miniature."""

from reports.edges import nri_proof
from tests.learning_to_simulate import models
from tests.nri import small


def test_proof_simulates_trains_measures_and_draws(tmp_path):
    config = nri_proof.NriConfig(**small.TINY | {'window': 48, 'batch_size': 64, 'epochs': 2})
    counts = {'train': 32, 'valid': 16, 'test': 16}
    with models.eagerly():
        result = nri_proof.run('springs', 3, str(tmp_path), counts, config)
    assert [row['epoch'] for row in result['curve']] == [1, 2]
    assert 0.5 <= result['test_accuracy'] <= 1 and result['runs'] == counts
    nri_proof.draw(result, str(tmp_path / 'curve.png'))
    assert (tmp_path / 'curve.png').read_bytes().startswith(b'\x89PNG')
    # The same model, as one that was trained elsewhere, on the same test runs made once more.
    again = nri_proof.run(
        'springs', 3, str(tmp_path / 'again'), counts, config, str(tmp_path / 'model_springs3_0')
    )
    assert again == result


def test_every_system_has_settings():
    for system, n_objects in nri_proof.PUBLISHED:
        counts, config = nri_proof.settings_of(system, n_objects)
        assert counts['train'] >= 10000 and config.decay_start < config.epochs
        _, central = nri_proof.settings_of(system, n_objects, central=True)
        assert central.central and not config.central
        # Only charges act on each other whatever their type.
        assert config.skip_first == central.skip_first == (system != 'charged')
