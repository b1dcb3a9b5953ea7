"""Pictures and movies of a rollout, on a made-up excavation."""

import dataclasses
import json
import os
import shutil

import numpy as np
import pytest

from learning_to_simulate import render_rollout
from learning_to_simulate.rendering import (
    movie_files,
    particle_views,
    rollout_figures,
    rollout_frames,
)
from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH
from pca_tools import files
from pca_tools.subspace import Subspace
from tests.learning_to_simulate import synthetic, synthetic_rollout
from tests.learning_to_simulate.synthetic_rollout import DT, N_FRAMES, N_GIVEN, N_RIGID
from tests.pca_tools.commands import call_command

N_SHOWN = N_FRAMES - N_GIVEN
NODES = 'initial_positions', 'predicted_rollout', 'ground_truth_rollout'


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """(rollout path, dataset folder)."""
    return synthetic_rollout.write(str(tmp_path_factory.mktemp('rollout')))


@pytest.fixture(scope='module')
def frames(made):
    return rollout_frames.load(*made)


@pytest.fixture(scope='module')
def view(frames):
    return particle_views.setup(frames, 'xy', np.arange(0, N_SHOWN, 3))


@pytest.fixture
def change(made, tmp_path):
    """Makes a copy of the rollout in which some arrays or some metadata are replaced, or left out
    where None; returns its path."""

    def changed(metadata=None, **changes):
        arrays = files.read_npz(made[0]) | changes
        if isinstance(metadata, dict):
            whole = json.loads(str(arrays['metadata'])) | metadata
            metadata = json.dumps({k: v for k, v in whole.items() if v is not None})
        if metadata is not None:
            arrays['metadata'] = np.array(metadata)
        path = str(tmp_path / 'rollout_test_0.npz')
        files.write_npz(path, **{name: a for name, a in arrays.items() if a is not None})
        return path

    return changed


def without_body(made):
    """Arrays of the rollout with its modes alone."""
    arrays = files.read_npz(made[0])
    modes = {key: arrays[key][:, N_RIGID:] for key in NODES}
    return modes | {'particle_types': arrays['particle_types'][N_RIGID:]}


def animated(frames, view, color_by='speed', **options):
    return rollout_figures.AnimatedFigure(frames, view, color_by, dpi=50, **options)


def strip(frames, view, **options):
    return rollout_figures.strip_figure(frames, view, [0, 12, 24], dpi=50, **options)


def check_places(drawn, frames, view, i):
    """That the soil of a view is that of the prediction in the i-th shown frame; its order."""
    place = frames.soil[PREDICTION][i][view.particles]
    order = np.argsort(place[:, 2], kind='stable')
    np.testing.assert_allclose(drawn.soil.get_offsets(), place[order][:, :2])
    return order


def test_particles_and_their_errors(made, frames, tmp_path, change):
    """Of the solver's own particles where there is a sample, else of all that are decoded."""
    data_path, numbers = shutil.copytree(made[1], str(tmp_path / 'data')), np.arange(8, N_FRAMES, 4)
    chosen = synthetic.write_particles(data_path)
    truth = synthetic.soil_of(data_path, 'test', 0)[numbers][:, chosen]
    space, arrays = Subspace.load(f'{data_path}/subspace.npz'), files.read_npz(made[0])
    predicted = space.decode(arrays['predicted_rollout'][:, N_RIGID:].astype(float))
    np.testing.assert_allclose(frames.soil[PREDICTION], predicted, atol=1e-12)
    square = ((predicted - frames.soil[TRUTH]) ** 2).mean()
    cut = json.loads(str(arrays['metadata']))['projection_mse']['test'][0]
    assert frames.soil_mm == pytest.approx(1e3 * np.sqrt(square + cut))
    frames = rollout_frames.load(made[0], data_path)
    np.testing.assert_array_equal(frames.frames, numbers)
    np.testing.assert_allclose(frames.soil[TRUTH], truth, atol=1e-6)
    found = predicted[numbers - N_GIVEN][:, chosen]
    np.testing.assert_allclose(frames.soil[PREDICTION], found, atol=1e-6)
    still = space.decode(arrays['initial_positions'][-1, N_RIGID:].astype(float))[chosen]
    for name, places in ((PREDICTION, found), ('persistence', still)):
        rms = 1e3 * np.sqrt(((places - truth) ** 2).mean(axis=(1, 2)))
        np.testing.assert_allclose(frames.soil_rms_mm[name], rms, rtol=1e-4)
    velocity = (found[3] - found[2]) / (4 * DT)
    np.testing.assert_allclose(frames.soil_velocity(PREDICTION, 3), velocity, atol=1e-9)
    assert "the solver's particles" in frames.space
    # A method without modes: its own particles, whatever stands for them in modes.
    indices = np.arange(space.n_soil)[chosen]
    own = {'predicted_particles': truth + 1e-3, 'particle_frames': numbers}
    frames = rollout_frames.load(change(**own, particle_indices=indices), data_path)
    np.testing.assert_allclose(frames.soil[PREDICTION], truth + 1e-3, atol=1e-9)
    assert frames.soil_mm == pytest.approx(1.0, rel=1e-2)


def test_particles_of_a_full_space_model_are_drawn_as_they_are(made, change):
    frames = rollout_frames.load(change({'mode_number': 2}), None)
    nodes = files.read_npz(made[0])['predicted_rollout']
    np.testing.assert_array_equal(frames.soil[PREDICTION], nodes[:, N_RIGID:])
    assert frames.rigid[TRUTH].shape[1] == N_RIGID


def test_captions_hold_the_errors_of_every_model(frames):
    truth, predicted = (frames.force[which][N_GIVEN:] for which in (TRUTH, PREDICTION))
    other = dataclasses.replace(frames, label='other', is_driven=True)
    first, second = rollout_figures.caption([frames, other], -1).splitlines()
    off = np.linalg.norm(predicted - truth)
    share, newtons = 100 * off / np.linalg.norm(truth), off / np.sqrt(truth.size)
    assert f'force error so far {newtons:.3g} N ({share:.0f} %)' in first
    assert f'prediction: soil error {frames.soil_rms_mm[PREDICTION][-1]:.2f} mm' in first
    assert 'body' not in first  # its motion is given
    drawbar = np.sqrt(((predicted - truth)[:, 0] ** 2).mean())
    assert second.startswith('other: ') and f'drawbar error so far {drawbar:.3g} N' in second
    assert f'soil error {frames.soil_mm:.2f} mm over all' in rollout_figures.caption([frames])


def test_titles_are_sentences(frames):
    assert frames.title == 'A blade cuts 80 mm deep at 0.1 m/s, leaning by 10° (case 125)'
    case = {'case': 'load_0007', 'diameter_m': 0.05, 'load_N': 225.0, 'load_min_N': 16.347,
            'load_max_N': 25.0, 'context': {'load': 25.0}}  # fmt: skip
    metadata = {'cases': {'test': [case, {'case': 4}]}, 'scene': {'name': 'wheel'}}
    title = rollout_frames._title(metadata, 'test', 0)
    assert title == 'A wheel of 0.05 m is driven freely under 16.3 to 25 N (load_0007)'
    assert rollout_frames._title(metadata, 'test', 1) == 'Wheel (case 4)'


def test_rollout_that_blew_up_is_cut(made, change):
    predicted = files.read_npz(made[0])['predicted_rollout']
    predicted[20:] = np.nan
    frames = rollout_frames.load(change(predicted_rollout=predicted), made[1])
    assert frames.n_frames == len(frames.force[TRUTH]) == N_GIVEN + 20
    assert frames.frames[-1] == N_GIVEN + 19 and np.isfinite(frames.soil_mm)
    assert 'not finite from frame 26' in frames.notes[0]


def test_bad_input_is_refused(made, change, tmp_path):
    files.write_npz(foreign := str(tmp_path / 'foreign.npz'), positions=np.zeros(3))
    for path, data_path, error, message in (
        ('none.npz', made[1], FileNotFoundError, 'no such file'),
        ('rollout.pkl', made[1], ValueError, 'is a pickle, which is never read'),
        (made[0], 'none', FileNotFoundError, 'no such dataset'),
        (foreign, made[1], ValueError, r"lacks \['initial_positions'.*it has \['positions'\]"),
        (change(**without_body(made)), None, ValueError, 'has modes only'),
    ):
        with pytest.raises(error, match=message):
            rollout_frames.load(path, data_path)
    arrays = files.read_npz(made[0])
    predicted, truth = arrays['predicted_rollout'], arrays['ground_truth_rollout']
    for changes, message in (
        ({'particle_types': arrays['particle_types'][1:]}, r'has shape \(6, 23, 3\), \(6, 22, 3\)'),
        ({'predicted_rollout': predicted[1:]}, 'has shape .*was expected'),
        ({'predicted_rollout': predicted.astype(complex)}, 'no real numbers'),
        ({'predicted_rollout': predicted * np.nan}, 'no predicted frame is finite'),
        ({'predicted_forces': None}, "lacks .'predicted_forces'"),
        ({'predicted_forces': predicted[0]}, 'predicted_forces has shape'),
        ({'ground_truth_rollout': truth * np.nan}, 'ground_truth_rollout has NaN'),
        ({'metadata': '{'}, 'is not JSON'),
        ({'metadata': json.dumps({'mode_number': 8})}, 'lacks .*dt'),
        ({'metadata': {'mode_number': 99}}, 'has 23 nodes but its metadata says mode_number 99'),
        ({'metadata': {'mode_number': 2}}, 'has 3 modes, the rollout has 2'),
        ({'metadata': {'pca': {'digest': 'f' * 64}}}, 'not the subspace of this rollout'),
    ):
        with pytest.raises(ValueError, match=message):
            rollout_frames.load(change(**changes), made[1])
    out = str(tmp_path / 'out')
    with pytest.raises(ValueError, match=r"--format has \['avi'\]; there are png, gif"):
        render_rollout.render(*made, out, formats=['gif', 'avi'])
    truth[5, N_RIGID, 0] += 1e-3
    other = {'other': change(ground_truth_rollout=truth)}
    with pytest.raises(ValueError, match=r'\(other\) is no rollout of the run of'):
        render_rollout.render(*made, out, beside=other)
    assert not os.path.exists(out)


@pytest.mark.parametrize('way', [1.0, -1.0])
def test_a_force_against_the_way_is_drawn_upwards_and_a_peak_is_not_clipped(frames, view, way):
    start, steps = frames.rigid[TRUTH][:1], np.arange(frames.n_frames)[:, None, None]
    there = start + 0.01 * way * steps * [1.0, 0.0, 0.0]
    force = np.tile([-30.0 * way, 10.0, 0.0], (frames.n_frames, 1))
    peak = force.copy()
    peak[20, :2] = -900.0 * way, -700.0
    moved = dataclasses.replace(
        frames, rigid=dict.fromkeys(frames.rigid, there), force={TRUTH: force, PREDICTION: peak}
    )
    (axes,) = (a for a in strip(moved, view).axes if 'force' in a.get_ylabel())
    low, high = axes.get_ylim()
    assert low < -700 and high > 900
    drawn = {line.get_label(): line.get_ydata()[-1] for line in axes.lines}
    for name in ('solver', PREDICTION):
        assert (drawn[f'against the way, {name}'], drawn[f'up, {name}']) == (30, 10)
    assert len(axes.get_legend().get_texts()) == 4


def test_the_error_axis_shows_frames_that_are_exact(frames, view):
    error = frames.soil_rms_mm[PREDICTION].copy()
    error[:3] = 0.0, 1e-6, 1e-4
    exact = dataclasses.replace(frames, soil_rms_mm=frames.soil_rms_mm | {PREDICTION: error})
    (axes,) = (a for a in strip(exact, view).axes if a.get_yscale() == 'log')
    shown = axes.lines[0].get_ydata()
    assert axes.get_ylim()[0] < shown[0] == shown[2] < error[3:].min()
    np.testing.assert_array_equal(shown[3:], error[3:])


def test_soil_body_and_force_are_where_they_should_be(frames, view):
    """Whatever was drawn before; in colours of the error, the truth has one colour."""
    figure = animated(frames, view)
    for i in (33, 20):
        pixels = figure.draw(i)
    np.testing.assert_array_equal(pixels, animated(frames, view).draw(20))
    assert pixels.shape[0] % 2 == pixels.shape[1] % 2 == 0
    order = check_places(figure.views[1], frames, view, 20)
    place, before = (frames.soil[PREDICTION][i][view.particles] for i in (20, 19))
    speed = 1e3 * np.linalg.norm(place - before, axis=1)[order] / DT
    np.testing.assert_allclose(figure.views[1].soil.get_array(), speed, atol=1e-6)
    for which, shown in zip((TRUTH, PREDICTION), figure.views):
        body, force = frames.rigid[which][N_GIVEN + 20], frames.force[which][N_GIVEN + 20]
        np.testing.assert_allclose(shown.arrow.get_offsets()[0], body.mean(axis=0)[:2])
        np.testing.assert_allclose([shown.arrow.U[0], shown.arrow.V[0]], force[:2])
        ends = shown.body.get_xy()[:2]  # a blade is a line from the side
        np.testing.assert_allclose(ends[np.argsort(ends[:, 1])], body[[0, -1]][:, :2], atol=1e-6)
    figure = animated(frames, view, 'error')
    figure.draw(30)
    truth, prediction = (drawn.soil.get_array() for drawn in figure.views)
    error = 1e3 * np.linalg.norm(frames.soil_error(30)[view.particles], axis=1)
    assert truth is None
    np.testing.assert_allclose(np.sort(prediction), np.sort(error))


def test_a_wheel_is_a_circle(frames, view):
    angle = np.arange(N_RIGID) * np.pi / 5 + 0.1
    ring = [0.5 + 0.15 * np.cos(angle), 0.4 + 0.15 * np.sin(angle), np.repeat([0.3, 0.4], 10)]
    there = np.tile(np.stack(ring, -1), (frames.n_frames, 1, 1))
    drawn = animated(dataclasses.replace(frames, rigid=dict.fromkeys(frames.rigid, there)), view)
    drawn.draw(20)
    outline = drawn.views[0].body.get_xy()
    np.testing.assert_allclose(np.linalg.norm(outline - [0.5, 0.4], axis=1), 0.15, rtol=1e-5)
    assert len(drawn.views[0].spokes.get_segments()) == N_RIGID


def test_a_second_model_is_drawn_beside_the_first(frames, view):
    """Each with its own soil; a strip gets a row more."""
    soil = frames.soil | {PREDICTION: frames.soil[PREDICTION] + [0.01, 0, 0]}
    other = dataclasses.replace(frames, label='other', soil=soil)
    figure = animated(frames, view, beside=[other])
    assert len(figure.views) == 3 and figure.draw(20).any()
    for drawn, one in zip(figure.views[1:], (frames, other)):
        check_places(drawn, one, view, 20)
    alone, both = strip(frames, view), strip(frames, view, beside=[other])
    assert len(both.axes) == len(alone.axes) + 3
    assert figure.caption.get_text().count('soil error') == 2
    assert any('other' in axes.get_ylabel() for axes in both.axes)


@pytest.mark.parametrize(
    'plane, left_out', [('yx', 'subspace'), ('zy', 'force'), ('xz', 'body'), ('xy', 'motion')]
)
def test_every_scene_can_be_drawn(made, change, plane, left_out):
    arrays = files.read_npz(made[0])
    still = np.broadcast_to(arrays['initial_positions'][0], arrays['predicted_rollout'].shape)
    changes = {
        'force': dict.fromkeys(('initial_forces', 'ground_truth_forces', 'predicted_forces')),
        'body': without_body(made),
        'motion': dict(zip(NODES, (still[:N_GIVEN], still, still))),
    }
    metadata = {'projection_mse': None} if left_out == 'motion' else None
    path = change(metadata, **changes.get(left_out, {}))
    frames = rollout_frames.load(path, None if left_out == 'subspace' else made[1])
    view = particle_views.setup(frames, plane, np.arange(0, N_SHOWN, 20))
    figure = animated(frames, view, 'error' if left_out == 'motion' else 'speed')
    assert (figure.draw(0) != figure.draw(20)).any()
    strip(frames, view).canvas.draw()


@pytest.mark.parametrize(('up_axis', 'axes'), [(0, (1, 0)), (1, (0, 1)), (2, (0, 2))])
def test_upward_axis_is_up(made, change, monkeypatch, up_axis, axes):
    scene = {'rigid_motion': 'prescribed', 'force': True, 'up_axis': up_axis}
    frames = rollout_frames.load(change({'scene': scene}), made[1])
    monkeypatch.setattr(particle_views, '_SIDE_VIEW_LEAST', 10)
    monkeypatch.setattr(particle_views, '_SIDE_VIEW_SHARE', 0.0)
    side = particle_views.setup(frames, None, np.arange(0, N_SHOWN, 20))
    assert side.plane == axes
    depth = 3 - sum(axes)
    away = np.abs(frames.start[:, depth] - frames.rigid[TRUTH][0][:, depth].mean())
    assert side.particles.tolist() == np.argsort(away, kind='stable')[:10].tolist()


def test_movies_have_the_frames_they_were_given(tmp_path):
    image, ffmpeg = pytest.importorskip('PIL.Image'), pytest.importorskip('imageio_ffmpeg')
    frames = np.full((4, 20, 30, 3), 255, np.uint8)
    for i, frame in enumerate(frames):
        frame[2:8, 5 * i : 5 * i + 5] = (200, 40 * i, 10)
    movie_files.write(path := str(tmp_path / 'a.gif'), 'gif', iter(frames), 0.05)
    with image.open(path) as gif:
        assert gif.n_frames == 4
        for i, frame in enumerate(frames):
            gif.seek(i)
            np.testing.assert_array_equal(np.asarray(gif.convert('RGB')), frame)
            assert gif.info['duration'] == (50 if i < 3 else 1500)
    levels = [20, 120, 220]
    plain = (np.full((64, 96, 3), x, np.uint8) for x in levels)
    movie_files.write(path := str(tmp_path / 'a.mp4'), 'mp4', plain, 0.05)
    reader = ffmpeg.read_frames(path)
    about = next(reader)
    assert about['size'] == (96, 64) and about['fps'] == 20
    means = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
    np.testing.assert_allclose(means, levels, atol=4)  # H.264 is lossy


def test_command(made, tmp_path):
    command = 'learning_to_simulate.render_rollout'
    done = call_command(
        command, f'--rollout_path={tmp_path}/none.npz', f'--output_path={tmp_path}/out'
    )
    assert (done.returncode, done.stderr) == (1, f'error: {tmp_path}/none.npz: no such file\n')
    assert not os.listdir(tmp_path)
    done = call_command(
        command, f'--rollout_path={made[0]}', f'--data_path={made[1]}', f'--output_path={tmp_path}',
        '--step_stride=20', '--color_by=error', '--format=png,gif,mp4,vtp',
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for end in ('.png', '.gif', '.mp4', '_vtk/truth.pvd'):
        path = tmp_path / f'rollout_test_0{end}'
        assert path.exists() and str(path) in done.stdout
    assert 'A blade cuts' in done.stdout and 'soil error' in done.stdout
