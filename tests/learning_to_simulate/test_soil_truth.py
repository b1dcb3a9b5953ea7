"""The one error of soil: against particles made by hand, and the same in every printout."""

import numpy as np
import pytest

from learning_to_simulate import evaluation, metrics, reading_utils, soil_truth
from learning_to_simulate.live import paths
from learning_to_simulate.rendering import rollout_figures, rollout_frames
from pca_tools import dataset, files
from pca_tools.subspace import Subspace
from tests.learning_to_simulate import models, synthetic

H, FRAMES, N_SOIL = 6, synthetic.N_FRAMES, synthetic.N_SOIL
CUT = [4e-6, 9e-6]


@pytest.fixture
def folder(tmp_path):
    """A dataset with a subspace and, as yet, no particles."""
    path = synthetic.write_dataset(tmp_path / 'data', n_run=4)
    synthetic.write_subspace(path)
    metadata = dataset.read_metadata(path)
    files.write_json(f'{path}/metadata.json', metadata | {'projection_mse': {'test': CUT}})
    return path


def truth_of(folder, record=1):
    """`SoilTruth` of a test run, and its scores [T, r, 3]."""
    run = dataset.read_split(folder, 'test')[record]
    scores = run.position[:, run.n_rigid :].astype(np.float64)
    return soil_truth.TruthReader(folder).read('test', record, scores, N_SOIL), scores


def test_modes_alone_add_what_they_cut_off(folder):
    truth, scores = truth_of(folder)
    still = np.repeat(scores[H:][:1], FRAMES - H, axis=0)
    # Modes are orthonormal: the squared errors of scores are those of particles.
    mse = metrics.soil_mse(still[None], scores[None, H:], 0, N_SOIL)[0]
    assert truth.space == soil_truth.WITH_CUT_OFF and truth.particles.shape[1] == N_SOIL
    assert truth.soil_mm(truth.of_modes(still)) == pytest.approx(1e3 * np.sqrt(mse + CUT[1]))
    assert truth.soil_mm(truth.of_modes(scores[H:])) == pytest.approx(3.0)
    alone = soil_truth.of_nodes(scores, N_SOIL)
    assert alone.space == soil_truth.SUBSPACE
    assert alone.soil_mm(alone.of_modes(still)) == pytest.approx(1e3 * np.sqrt(mse))
    first = alone.of_modes(still[:, :1])  # modes that are left out say 0
    assert (first[:, 1:] == 0).all() and first.shape == alone.particles.shape


def test_particles_of_the_solver_are_the_truth_where_there_are_some(folder):
    chosen, soil = synthetic.write_particles(folder), synthetic.soil_of(folder, 'test', 1)
    truth, scores = truth_of(folder)
    assert truth.space == soil_truth.PARTICLES and truth.cut_off == 0.0
    assert truth.frames.tolist() == list(range(8, FRAMES, 4))
    np.testing.assert_allclose(truth.particles, soil[8::4, chosen], atol=1e-7)
    np.testing.assert_allclose(truth.start, soil[0, chosen], atol=1e-7)
    space = Subspace.load(f'{folder}/subspace.npz')
    error = (space.decode(scores[8::4]) - soil[8::4])[:, chosen]
    expected = 1e3 * np.sqrt((error**2).mean())
    assert truth.soil_mm(truth.of_modes(scores[H:])) == pytest.approx(expected, rel=1e-4)
    frames, everyone = np.arange(H, FRAMES), np.arange(N_SOIL)
    assert truth.soil_mm(truth.of_particles(soil[H:], frames, everyone)) < 1e-3
    with pytest.raises(ValueError, match='lacks 8 frames and 1 particles'):
        truth.of_particles(soil[H:8, 1:], frames[:2], everyone[1:])
    with pytest.raises(ValueError, match='for 2 frames'):
        truth.of_particles(soil[H:], frames[:2], everyone)
    with pytest.raises(ValueError, match='has a record 2'):
        soil_truth.TruthReader(folder).read('test', 2, scores, N_SOIL)


@pytest.mark.parametrize('sampled', [True, False])
def test_every_printout_has_the_same_number(tmp_path, sampled):
    """Table and metrics.json, file, picture, caption, protocol, and a rollout of the API."""
    data = str(tmp_path / 'data')
    model, _, metadata = models.make(data)
    synthetic.write_subspace(data)
    if sampled:
        synthetic.write_particles(data)
    groups = reading_utils.read_groups(data, 'test', metadata)
    evaluator = evaluation.Evaluator(model, metadata)
    results, summary = evaluator.run(groups, 'test')
    out = str(tmp_path / 'out')
    evaluation.save_rollouts(out, 'test', results, summary, metadata, 64 * 'a')
    numbers = [row['soil_mm'] for row in summary['runs']['model']]
    assert numbers[0] != pytest.approx(numbers[1], rel=1e-3)
    text = evaluation.table(summary)
    assert f'{np.mean(numbers):.4g}' in text and summary['soil_error'] in text
    assert summary['soil_error'] == (soil_truth.PARTICLES if sampled else soil_truth.SUBSPACE)
    scene = model.simulator.scene
    said = files.read_json(f'{out}/metrics.json')['runs']['model']
    for record, (judged, number) in enumerate(zip(said, numbers, strict=True)):
        same = pytest.approx(number, rel=1e-5)
        assert judged['soil_mm'] == same
        frames = rollout_frames.load(f'{out}/rollout_test_{record}.npz', data)
        assert frames.soil_mm == same and frames.space == summary['soil_error']
        assert f'soil error {number:.2f} mm' in rollout_figures.caption([frames])
        _, group, rollout = results[record]
        found = paths.of_recorded_run(group, rollout, scene, None, 'rollout')
        assert found.soil_mm == same and rollout_frames.of_rollout(found).soil_mm == same
