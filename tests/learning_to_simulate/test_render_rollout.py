"""Pictures and movies of a rollout, on a made-up excavation."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys

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
from tests.learning_to_simulate import synthetic_rollout
from tests.learning_to_simulate.synthetic_rollout import DT, N_GIVEN, N_RIGID

N_FRAMES = 60
N_SHOWN = N_FRAMES - N_GIVEN


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """(rollout path, dataset folder, particles before any projection)."""
    return synthetic_rollout.write(str(tmp_path_factory.mktemp('rollout')), N_FRAMES)


@pytest.fixture(scope='module')
def frames(made):
    return rollout_frames.load(*made[:2])


@pytest.fixture(scope='module')
def view(frames):
    return particle_views.setup(frames, 'xy', np.arange(0, N_SHOWN, 3))


def without_body(made):
    """Arrays of the rollout with its modes alone."""
    arrays = files.read_npz(made[0])
    names = 'initial_positions', 'predicted_rollout', 'ground_truth_rollout'
    return {key: arrays[key][:, N_RIGID:] for key in names} | {
        'particle_types': arrays['particle_types'][N_RIGID:]
    }


def changed(made, tmp_path, **changes):
    """Path of a copy of the rollout with some arrays replaced, or left out where None."""
    arrays = files.read_npz(made[0]) | changes
    path = str(tmp_path / 'rollout_test_0.npz')
    files.write_npz(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


class TestFrames:
    @pytest.mark.parametrize('sampled', [False, True])
    def test_particles_and_their_errors(self, made, tmp_path, sampled):
        """Of the solver's own particles where there is a sample, else of all that are decoded."""
        data_path, chosen, given = made[1], slice(None), {}
        space = Subspace.load(os.path.join(made[1], 'subspace.npz'))
        arrays = files.read_npz(made[0])
        truth, predicted = (
            np.concatenate([arrays['initial_positions'], arrays[key]])[:, N_RIGID:].astype(float)
            for key in ('ground_truth_rollout', 'predicted_rollout')
        )
        frames = np.arange(N_GIVEN, N_FRAMES)
        soil = {TRUTH: space.decode(truth), PREDICTION: space.decode(predicted)}
        cut = json.loads(str(arrays['metadata']))['projection_mse']['test'][0]
        if sampled:
            data_path, chosen = str(tmp_path / 'data'), np.arange(0, space.n_soil, 5)
            shutil.copytree(made[1], data_path)
            synthetic_rollout.write_sample(data_path, made[2], chosen)
            soil[TRUTH], frames, cut = made[2], np.arange(8, N_FRAMES, 4), 0.0
        soil = {which: x[frames][:, chosen] for which, x in soil.items()}
        frames_ = rollout_frames.load(made[0], data_path, 'm')
        np.testing.assert_array_equal(frames_.frames, frames)
        for which, x in soil.items():
            np.testing.assert_allclose(frames_.soil[which], x, atol=1e-6 if sampled else 1e-12)
        square = ((soil[PREDICTION] - soil[TRUTH]) ** 2).mean(axis=(1, 2))
        rms, close = frames_.soil_rms_mm, {'rtol': 1e-4 if sampled else 1e-9, 'atol': 1e-9}
        np.testing.assert_allclose(rms[PREDICTION], 1e3 * np.sqrt(square), **close)
        np.testing.assert_allclose(frames_.soil_mm, 1e3 * np.sqrt(square.mean() + cut), rtol=1e-4)
        still = space.decode(truth[N_GIVEN - 1])[chosen] - soil[TRUTH]
        still = 1e3 * np.sqrt((still**2).mean(axis=(1, 2)))
        np.testing.assert_allclose(rms['persistence'], still, **close)
        i = len(frames) // 2
        apart = (frames[i] - frames[i - 1]) * DT
        velocity = (soil[PREDICTION][i] - soil[PREDICTION][i - 1]) / apart
        np.testing.assert_allclose(frames_.soil_velocity(PREDICTION, i), velocity, atol=1e-9)
        text = rollout_figures.caption([frames_])
        assert f'm: soil error {frames_.soil_mm:.2f} mm' in text
        assert ("the solver's particles" in frames_.space) == sampled
        # A method without modes: its own particles, whatever stands for them in modes.
        own = soil[TRUTH] + 1e-3 if sampled else soil[PREDICTION]
        given = {'predicted_particles': own, 'particle_frames': frames,
                 'particle_indices': np.arange(space.n_soil)[chosen]}  # fmt: skip
        own_frames = rollout_frames.load(changed(made, tmp_path, **given), data_path)
        np.testing.assert_allclose(own_frames.soil[PREDICTION], own, atol=1e-9)
        if sampled:
            assert own_frames.soil_mm == pytest.approx(1.0, rel=1e-2)

    def test_particles_of_a_full_space_model_are_drawn_as_they_are(self, made, tmp_path):
        arrays, metadata = files.read_npz(made[0]), None
        metadata = json.loads(str(arrays['metadata'])) | {'mode_number': 5}
        path = changed(made, tmp_path, metadata=np.array(json.dumps(metadata)))
        frames = rollout_frames.load(path, None)
        for which, key in ((TRUTH, 'ground_truth_rollout'), (PREDICTION, 'predicted_rollout')):
            np.testing.assert_array_equal(frames.soil[which], arrays[key][:, N_RIGID:])
        assert frames.rigid[TRUTH].shape[1] == N_RIGID

    def test_captions_hold_the_errors_of_every_model(self, frames):
        assert frames.title == 'A blade cuts 80 mm deep at 0.1 m/s, leaning by 10° (case 125)'
        truth, predicted = (frames.force[which][N_GIVEN:] for which in (TRUTH, PREDICTION))
        size = np.linalg.norm(predicted - truth)
        share = 100 * size / np.linalg.norm(truth)
        other = dataclasses.replace(frames, label='other', is_driven=True)
        first, second = rollout_figures.caption([frames, other], -1).splitlines()
        newtons = size / np.sqrt(truth.size)
        assert f'force error so far {newtons:.3g} N ({share:.0f} %)' in first
        assert f'prediction: soil error {frames.soil_rms_mm[PREDICTION][-1]:.2f} mm' in first
        off = np.sqrt(((predicted - truth)[:, 0] ** 2).mean())
        assert second.startswith('other: ') and f'drawbar error so far {off:.3g} N' in second
        assert 'body' not in first  # its motion is given

    def test_rollout_that_blew_up_is_cut(self, made, tmp_path):
        predicted = files.read_npz(made[0])['predicted_rollout']
        predicted[30:] = np.nan
        path = changed(made, tmp_path, predicted_rollout=predicted)
        frames = rollout_frames.load(path, made[1])
        assert frames.n_frames == len(frames.force[TRUTH]) == N_GIVEN + 30
        assert frames.frames[-1] == N_GIVEN + 29 and np.isfinite(frames.soil_mm)
        assert 'not finite from frame 36' in frames.notes[0]

    def test_a_wheel_has_a_sentence_as_well(self):
        case = {'case': 'load_0007', 'diameter_m': 0.05, 'load_N': 225.0, 'load_min_N': 16.347,
                'load_max_N': 25.0, 'context': {'load': 25.0}}  # fmt: skip
        metadata = {'cases': {'test': [case, {'case': 4}]}, 'scene': {'name': 'wheel'}}
        title = rollout_frames._title(metadata, 'test', 0)
        assert title == 'A wheel of 0.05 m is driven freely under 16.3 to 25 N (load_0007)'
        assert rollout_frames._title(metadata, 'test', 1) == 'Wheel (case 4)'


class TestBadInput:
    def check(self, path, data_path, message, error=ValueError):
        with pytest.raises(error, match=message):
            rollout_frames.load(path, data_path)

    def test_files_that_are_not_rollouts(self, made, tmp_path):
        self.check(str(tmp_path / 'none.npz'), made[1], 'no such file', FileNotFoundError)
        self.check(str(tmp_path / 'rollout.pkl'), made[1], 'is a pickle, which is never read')
        self.check(made[0], str(tmp_path / 'none'), 'no such dataset', FileNotFoundError)
        foreign = str(tmp_path / 'foreign.npz')
        files.write_npz(foreign, positions=np.zeros(3))
        self.check(foreign, made[1], r"lacks \['initial_positions'.*it has \['positions'\]")

    def test_arrays_that_do_not_fit(self, made, tmp_path):
        arrays = files.read_npz(made[0])
        metadata = json.loads(str(arrays['metadata']))

        def check(message, data_path=made[1], **changes):
            self.check(changed(made, tmp_path, **changes), data_path, message)

        check(r'has shape \(6, 28, 3\), \(6, 27, 3\)', particle_types=arrays['particle_types'][1:])
        check('has shape .*was expected', predicted_rollout=arrays['predicted_rollout'][1:])
        check("lacks .'predicted_forces'", predicted_forces=None)
        check('predicted_forces has shape', predicted_forces=arrays['predicted_forces'][1:])
        nans = {k: arrays[k] * np.nan for k in ('ground_truth_rollout', 'predicted_rollout')}
        check('ground_truth_rollout has NaN', **nans)
        check('no predicted frame is finite', predicted_rollout=nans['predicted_rollout'])
        check('is not JSON', metadata=np.array('{'))
        check('lacks .*dt', metadata=np.array(json.dumps({'mode_number': 8})))
        many = json.dumps(metadata | {'mode_number': 99})
        check('has 28 nodes but its metadata says mode_number 99', metadata=np.array(many))
        fewer = json.dumps(metadata | {'mode_number': 7})
        check('has 8 modes, the rollout has 7', metadata=np.array(fewer))
        other = json.dumps(metadata | {'pca': {'digest': 'f' * 64}})
        check('not the subspace of this rollout', metadata=np.array(other))

    def test_modes_alone_cannot_be_drawn(self, made, tmp_path):
        self.check(changed(made, tmp_path, **without_body(made)), None, 'has modes only')

    def test_unknown_format(self, made, tmp_path):
        with pytest.raises(ValueError, match=r"--format has \['avi'\]; there are png, gif"):
            render_rollout.render(*made[:2], str(tmp_path), formats=['gif', 'avi'])
        assert not os.listdir(tmp_path)


class TestPictures:
    def test_the_force_axis_clips_no_prediction(self, made, tmp_path):
        force = files.read_npz(made[0])['predicted_forces']
        force[20] = [900.0, -700.0, 0.0]
        frames = rollout_frames.load(changed(made, tmp_path, predicted_forces=force), made[1])
        view = particle_views.setup(frames, 'xy', np.arange(0, 50, 3))
        figure = rollout_figures.strip_figure(frames, view, [0, 20, 40], dpi=50)
        (axes,) = (a for a in figure.axes if 'force' in a.get_ylabel())
        low, high = axes.get_ylim()
        assert low < -700 and high > 900
        names = {text.get_text() for text in axes.get_legend().get_texts()}
        assert names == {f'{a}, {name}' for a in 'xy' for name in ('ground truth', PREDICTION)}

    def test_frames_do_not_depend_on_what_was_drawn_before(self, frames, view):
        moved = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=60)
        for frame in (0, 53, 30):
            pixels = moved.draw(frame)
        fresh = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=60).draw(30)
        np.testing.assert_array_equal(pixels, fresh)
        assert pixels.shape[0] % 2 == pixels.shape[1] % 2 == 0

    def test_soil_body_and_force_are_where_they_should_be(self, frames, view):
        figure = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=60)
        figure.draw(40)
        place = frames.soil[PREDICTION][40][view.particles]
        speed = np.linalg.norm(place - frames.soil[PREDICTION][39][view.particles], axis=1) / DT
        order, drawn = np.argsort(place[:, 2], kind='stable'), figure.views[1].soil
        np.testing.assert_allclose(drawn.get_offsets(), place[order][:, :2])
        np.testing.assert_allclose(drawn.get_array(), 1e3 * speed[order], atol=1e-6)
        at = N_GIVEN + 40
        for which, shown in zip((TRUTH, PREDICTION), figure.views):
            centre = frames.rigid[which][at].mean(axis=0)[:2]
            np.testing.assert_allclose(shown.arrow.get_offsets()[0], centre)
            arrow = [shown.arrow.U[0], shown.arrow.V[0]]
            np.testing.assert_allclose(arrow, frames.force[which][at, :2])

    def test_error_colours_only_the_prediction(self, frames, view):
        figure = rollout_figures.AnimatedFigure(frames, view, 'error', dpi=60)
        figure.draw(50)
        truth, prediction = (drawn.soil for drawn in figure.views)
        assert truth.get_array() is None
        error = 1e3 * np.linalg.norm(frames.soil_error(50)[view.particles], axis=1)
        np.testing.assert_allclose(np.sort(prediction.get_array()), np.sort(error))

    def test_a_second_model_is_drawn_beside_the_first(self, made, frames, view, tmp_path):
        """Each with its own soil; a strip gets a row more."""
        arrays = files.read_npz(made[0])
        shifted = arrays['predicted_rollout'].copy()
        shifted[:, N_RIGID, 0] += 0.3
        path = changed(made, tmp_path, predicted_rollout=shifted)
        other = rollout_frames.load(path, made[1], 'other')
        figure = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=60, beside=[other])
        assert len(figure.views) == 3 and figure.draw(40).any()
        for drawn, one in zip(figure.views[1:], (frames, other)):
            place = one.soil[PREDICTION][40][view.particles]
            order = np.argsort(place[:, 2], kind='stable')
            np.testing.assert_allclose(drawn.soil.get_offsets(), place[order][:, :2])
        alone = rollout_figures.strip_figure(frames, view, [0, 20, 40], dpi=50)
        both = rollout_figures.strip_figure(frames, view, [0, 20, 40], dpi=50, beside=[other])
        assert len(both.axes) == len(alone.axes) + 3
        assert figure.caption.get_text().count('soil error') == 2
        names = [axes.get_ylabel() for axes in both.axes]
        assert any('other' in name for name in names)

        _, written = render_rollout.render(
            *made[:2], str(tmp_path), formats=['gif'], step_stride=20, beside={'other': path}
        )
        assert os.path.getsize(written[0]) > 1000

    def test_a_rollout_of_another_run_is_not_drawn_beside(self, made, tmp_path):
        arrays = files.read_npz(made[0])
        moved = arrays['ground_truth_rollout'].copy()
        moved[5, N_RIGID, 0] += 1e-3
        path = changed(made, tmp_path, ground_truth_rollout=moved)
        with pytest.raises(ValueError, match=r'\(other\) is no rollout of the run of'):
            render_rollout.render(*made[:2], str(tmp_path / 'out'), beside={'other': path})
        assert not (tmp_path / 'out').exists()

    def test_blade_is_a_line_from_the_side_and_a_wheel_a_circle(self, made, frames, view, tmp_path):
        drawn = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=60)
        drawn.draw(20)
        ends = drawn.views[0].body.get_xy()[:2]
        body = frames.rigid[TRUTH][N_GIVEN + 20]
        np.testing.assert_allclose(ends[np.argsort(ends[:, 1])], body[[0, 15]][:, :2], atol=1e-6)

        angle = np.arange(N_RIGID) * np.pi / 5 + 0.1
        ring = np.stack(
            [0.5 + 0.15 * np.cos(angle), 0.4 + 0.15 * np.sin(angle), np.repeat([0.3, 0.4], 10)],
            axis=-1,
        )
        arrays = files.read_npz(made[0])
        for key in ('initial_positions', 'predicted_rollout', 'ground_truth_rollout'):
            arrays[key][:, :N_RIGID] = ring
        frames = rollout_frames.load(changed(made, tmp_path, **arrays), made[1])
        drawn = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=60)
        drawn.draw(20)
        outline = drawn.views[0].body.get_xy()
        radius = np.linalg.norm(outline - [0.5, 0.4], axis=1)
        np.testing.assert_allclose(radius, 0.15, rtol=1e-5)
        assert len(drawn.views[0].spokes.get_segments()) == N_RIGID

    @pytest.mark.parametrize(
        'plane, left_out',
        [
            *((plane, 'nothing') for plane in ('xz', 'zy', 'yx')),
            *(('xy', part) for part in ('subspace', 'force', 'body')),
        ],
    )
    def test_every_scene_can_be_drawn(self, made, tmp_path, plane, left_out):
        changes, data_path = {}, made[1]
        if left_out == 'subspace':
            data_path = None
        elif left_out == 'force':
            changes = dict.fromkeys(('initial_forces', 'ground_truth_forces', 'predicted_forces'))
        elif left_out == 'body':
            changes = without_body(made)
        frames = rollout_frames.load(changed(made, tmp_path, **changes), data_path)
        drawn = np.arange(0, N_SHOWN, 20)
        view = particle_views.setup(frames, plane, drawn)
        figure = rollout_figures.AnimatedFigure(frames, view, 'speed', dpi=50)
        pixels = np.stack([figure.draw(int(frame)) for frame in drawn])
        assert (pixels[0] != pixels[1]).any()
        rollout_figures.strip_figure(frames, view, drawn.tolist(), dpi=50).canvas.draw()

    @pytest.mark.parametrize(('up_axis', 'axes'), [(0, (1, 0)), (1, (0, 1)), (2, (0, 2))])
    def test_upward_axis_is_up(self, made, tmp_path, monkeypatch, up_axis, axes):
        metadata = json.loads(str(files.read_npz(made[0])['metadata']))
        metadata['scene']['up_axis'] = up_axis
        path = changed(made, tmp_path, metadata=np.array(json.dumps(metadata)))
        frames = rollout_frames.load(path, made[1])
        monkeypatch.setattr(particle_views, '_SIDE_VIEW_LEAST', 10)
        monkeypatch.setattr(particle_views, '_SIDE_VIEW_SHARE', 0.0)
        side = particle_views.setup(frames, None, np.arange(0, N_SHOWN, 20))
        assert side.plane == axes and len(side.particles) == 10
        depth = ({0, 1, 2} - set(axes)).pop()
        away = np.abs(frames.start[:, depth] - frames.rigid[TRUTH][0][:, depth].mean())
        assert set(side.particles) == set(np.argsort(away, kind='stable')[:10])

    def test_soil_at_rest_can_be_drawn(self, made, tmp_path):
        arrays = files.read_npz(made[0])
        metadata = json.loads(str(arrays['metadata']))
        del metadata['projection_mse']
        still = {
            key: np.broadcast_to(arrays['initial_positions'][0], arrays[key].shape)
            for key in ('initial_positions', 'predicted_rollout', 'ground_truth_rollout')
        }
        path = changed(made, tmp_path, metadata=np.array(json.dumps(metadata)), **still)
        frames = rollout_frames.load(path, made[1])
        drawn = np.arange(0, N_SHOWN, 20)
        view = particle_views.setup(frames, 'xy', drawn)
        rollout_figures.strip_figure(frames, view, drawn.tolist(), dpi=50).canvas.draw()
        figure = rollout_figures.AnimatedFigure(frames, view, 'error', dpi=50)
        assert figure.draw(0).any()


class TestMovies:
    def test_gif_shows_the_frames_it_was_given(self, tmp_path):
        image = pytest.importorskip('PIL.Image')
        frames = np.full((4, 20, 30, 3), 255, np.uint8)
        for i, frame in enumerate(frames):
            frame[2:8, 5 * i : 5 * i + 5] = (200, 40 * i, 10)
        path = str(tmp_path / 'a.gif')
        movie_files.write_gif(path, iter(frames), 0.05, frames)
        with image.open(path) as gif:
            assert gif.n_frames == 4
            for i, frame in enumerate(frames):
                gif.seek(i)
                np.testing.assert_array_equal(np.asarray(gif.convert('RGB')), frame)
                assert gif.info['duration'] == (50 if i < 3 else 1500)

    def test_mp4_has_the_frames_it_was_given(self, tmp_path):
        ffmpeg = pytest.importorskip('imageio_ffmpeg')
        levels = [20, 120, 220]
        frames = [np.full((64, 96, 3), level, np.uint8) for level in levels]
        path = str(tmp_path / 'a.mp4')
        movie_files.write_mp4(path, iter(frames), 0.05)
        reader = ffmpeg.read_frames(path)
        about = next(reader)
        assert about['size'] == (96, 64) and about['fps'] == 20
        means = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
        # H.264 is lossy; flat frames come back within 2 levels.
        np.testing.assert_allclose(means, levels, atol=4)


class TestCommand:
    def run(self, *arguments):
        return subprocess.run(
            [sys.executable, '-m', 'learning_to_simulate.render_rollout', *arguments],
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    @pytest.mark.parametrize('beside', ['other', '=x.npz', 'a=x.npz,a=y.npz'])
    def test_what_is_beside_needs_a_name_and_a_file(self, made, tmp_path, beside):
        done = self.run(
            f'--rollout_path={made[0]}', f'--data_path={made[1]}', f'--output_path={tmp_path}',
            f'--beside={beside}',
        )  # fmt: skip
        assert done.returncode == 1 and 'NAME=FILE was expected' in done.stderr

    def test_writes_all_formats_and_a_summary(self, made, tmp_path):
        done = self.run(
            f'--rollout_path={made[0]}', f'--data_path={made[1]}', f'--output_path={tmp_path}',
            '--step_stride=20', '--color_by=error', '--format=png,gif,mp4,vtp',
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        written = {name for name in os.listdir(tmp_path) if not name.startswith('.')}
        assert written == {f'rollout_test_0{end}' for end in ('.png', '.gif', '.mp4', '_vtk')}
        for end in ('.png', '.gif', '.mp4', '_vtk/truth.pvd'):
            assert str(tmp_path / f'rollout_test_0{end}') in done.stdout
        assert 'A blade cuts' in done.stdout and 'soil error' in done.stdout

    def test_bad_input_ends_with_its_message(self, tmp_path):
        done = self.run(f'--rollout_path={tmp_path}/none.npz', f'--output_path={tmp_path}/out')
        assert done.returncode == 1
        assert done.stderr.strip() == f'error: {tmp_path}/none.npz: no such file'
        assert not os.listdir(tmp_path)
