"""Training on a soil whose law is known: what is learned holds on a path that was not seen."""

import contextlib
import dataclasses
import types

import numpy as np
import pytest

from learning_to_simulate.soil_field import samples, training
from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.tools import Wheel
from pca_tools.workers import Outcome
from tests.learning_to_simulate.soil_field import worlds


def test_the_law_of_the_soil_is_learned():
    field, losses, pools = worlds.trained()
    assert set(losses) == {'loss_load', 'loss_surface', 'loss_soil'}
    assert all(len(pool) == 1 for pool in pools.values())
    run = worlds.run(17)
    frames, passage, risen, truth, _ = samples.episode_of(run)
    loads = field.loads(frames).mean(axis=0)
    assert np.linalg.norm((loads - truth)[:, :2]) < 0.25 * np.linalg.norm(truth[:, :2])
    assert np.abs(loads[:, [2, 3, 4]]).max() < 1e-3  # even ground pushes to no side
    rise, still = [], []
    for t, places, found in risen[2:]:
        at = samples.sweep.Frame(frames.bins[t : t + 1], frames.scalars[t : t + 1])
        seen = field.networks.compiled('rise', 1)(*at, *samples.placed(passage.strips, places))
        rise.append(((seen.numpy().mean(axis=0)[0] - found) ** 2).mean())
        still.append((found**2).mean())
    assert sum(rise) < 0.3 * sum(still)


def test_ranges_are_those_of_the_runs():
    field, _, _ = worlds.trained()
    low, high = field.ranges['depth']
    deepest = max((worlds.TOOL.radius - worlds.path(seed)[:, 1]).max() for seed in range(6))
    assert low == pytest.approx(-0.015, abs=1e-6) and high == pytest.approx(deepest, abs=1e-6)
    assert field.ranges['half_width'] == pytest.approx([0.15, 0.15])
    assert field.ranges['friction'][0] == pytest.approx(np.tan(np.radians(37.2348)), abs=1e-6)


def test_a_run_at_another_size_is_the_same_run_in_other_units():
    """Where the scale of the tool grows with it, all that the field sees and feels is as it was,
    but for the edge, which cells of the solver make blunter."""
    wide = worlds.run(3)
    wide = wide._replace(tool=dataclasses.replace(wide.tool, width=0.9))  # 1.5 times as taught
    copy = wide.resized(1.4)
    assert copy.tool.scale == pytest.approx(1.4 * wide.tool.scale) and copy.machine is None
    edge = (1.4 * (wide.tool.radius + 0.0033) - 0.0033) / copy.tool.scale
    copy = copy._replace(tool=dataclasses.replace(copy.tool, radius=1.4 * wide.tool.radius))
    networks = worlds.trained()[0].networks
    parts = [samples.load_part(networks, r, samples.episode_of(r)) for r in (wide, copy)]
    for one, other in zip(*((*p.inputs, p.target, p.weight) for p in parts), strict=True):
        assert np.allclose(one, other, rtol=1e-4, atol=1e-4 * np.abs(one).max())
    assert np.abs(parts[0].target).max() > 10
    seen = wide.resized(1.4).tool.values(wide.soil)
    assert seen[wide.tool.scalars.index('radius')] == pytest.approx(edge)
    assert training.copies_of(wide) == []  # they would teach nothing


def test_the_load_of_a_blade_learns_from_runs_at_other_sizes():
    run, networks = worlds.run(3), worlds.trained()[0].networks
    copies = training.copies_of(run)
    assert [c.tool.width for c in copies] == pytest.approx([0.3 * 0.77, 0.3 * 1.3])
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    pools = training.parts_of(field, [run])
    radius = [row.operand for row in networks.inputs.tables.load.rows].index('radius')
    edges = {
        round(1e3 * (0.01 * float(x) + 0.014), 2) for x in pools['load'][0].inputs[0][:, 0, radius]
    }
    assert edges == {14.0, 10.02, 19.19}
    narrow = run._replace(tool=dataclasses.replace(run.tool, width=0.16))
    assert [c.tool.width for c in training.copies_of(narrow)] == pytest.approx([0.208])


def test_a_wheel_learns_from_what_it_does_forwards_what_it_does_backwards():
    run = worlds.run(1, tool=Wheel(0.1, 0.1))
    run = run._replace(pose=run.pose + [0.0, 0.086, 0.0, 0.0, 0.0, 0.0, 0.0])
    copy = run.mirrored()
    place, other = place_of(run.pose[0]), place_of(copy.pose[0])
    # Where the one goes on along its heading, the other goes back; the heading is the same.
    np.testing.assert_allclose(place.along, other.along, atol=1e-12)
    here, there = (p.local(r.pose[:, :3]) for p, r in ((place, run), (other, copy)))
    np.testing.assert_allclose(there, here * [-1, 1, 1], atol=1e-12)
    np.testing.assert_allclose(other.turns(copy.pose)[:, 0], -place.turns(run.pose)[:, 0])
    ours, theirs = (samples.loads_of(r, p) for r, p in ((run, place), (copy, other)))
    np.testing.assert_allclose(theirs, ours * [-1, 1, 1, 1, -1, -1], atol=1e-9)
    assert np.abs(ours[:, [0, 5]]).max() > 10
    x, z = place.along @ [1, 0, 0] * 0.05, 0.0
    ground = run.terrain(24).at([x], [z]), copy.terrain(24).at([-x], [z])
    np.testing.assert_allclose(*ground, atol=1e-12)
    for again, value in zip(copy.mirrored(), run, strict=True):
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(again, value, atol=1e-12)

    field = training.make_field(worlds.CONFIG, 'wheel', worlds.SMALL)
    alone, both = (training.parts_of(field, [run], copies=c) for c in (False, True))
    # Bins reach less far behind: there an episode of particles ends sooner.
    for name, least in (('load', 2.0), ('surface', 1.9), ('soil', 1.05)):
        assert len(both[name][0].weight) >= least * len(alone[name][0].weight), name
    target = both['load'][0].target
    count = len(target) // 2
    np.testing.assert_allclose(target[count:], target[:count] * [-1, 1, 1, 1, -1, -1], atol=1e-4)


def test_samples_made_by_processes_are_those_made_here(monkeypatch):
    runs = [worlds.run(seed) for seed in (1, 2, 3)]
    runs[0] = runs[0]._replace(pose=runs[0].pose[:-8], force=runs[0].force[:-8],
                               torque=runs[0].torque[:-8], particles=None)  # fmt: skip
    fields = [training.make_field(worlds.CONFIG, 'blade', worlds.SMALL) for _ in range(2)]
    here = training.parts_of(fields[0], runs)
    monkeypatch.setattr(training, 'FEW', 2)
    found = training.parts_of(fields[1], runs, processes=2)
    assert fields[0].ranges == fields[1].ranges and here.keys() == found.keys()
    for name, parts in here.items():
        for one, other in zip(parts, found[name], strict=True):
            for a, b in zip((*one.inputs, *one[1:]), (*other.inputs, *other[1:]), strict=True):
                np.testing.assert_array_equal(a, b)
    one = types.SimpleNamespace(run=lambda function, items: [Outcome(2, None, 'IOError: gone')])
    monkeypatch.setattr(training.workers, 'start', lambda **how: contextlib.nullcontext(one))
    with pytest.raises(ValueError, match=f'run {runs[2].case}: IOError: gone'):
        training.parts_of(fields[1], runs, processes=2)


def test_a_training_follows_from_its_seed_and_bad_ones_are_refused():
    """That two of one seed are equal: `test_method`."""
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    pools = training.parts_of(field, [worlds.run(1)])
    steps: dict = {}
    saved = types.SimpleNamespace(
        restore=lambda name, state: (0, []),
        keep=lambda name, step, last, *state: steps.update({name: step}),
    )
    made = []
    for seed in (0, 1):
        config = worlds.SoilFieldConfig('soil_field', members=1, num_steps=4, seed=seed)
        other = training.make_field(config, 'blade', worlds.SMALL)
        for values, first in zip(other.networks.variables, field.networks.variables, strict=True):
            values.assign(first[:1])  # weights of one seed, draws of another
        training.fit(other, {'surface': pools['surface']}, progress=False, saved=saved)
        made.append(other.networks.surface.layers[0][0].numpy())
    assert steps == {'surface': 20} and (made[0] != made[1]).any()
    with pytest.raises(ValueError, match='no runs to learn from'):
        training.parts_of(field, [])
    pools['load'][0].target[:] = np.nan
    with pytest.raises(ValueError, match='loss of the load is nan at step 0'):
        training.fit(field, pools, progress=False)


def test_a_training_that_starts_from_another_field():
    first, _, pools = worlds.trained()
    frames = samples.episode_of(worlds.run(17)).frames
    other = training.make_field(worlds.CONFIG, 'blade', first=first)
    assert (other.loads(frames) == first.loads(frames)).all()
    before = first.networks.load.layers[0][0].numpy().copy()
    config = dataclasses.replace(worlds.CONFIG, num_steps=1, learning_rate=1e-4)
    near = training.make_field(config, 'blade', first=first)
    training.fit(near, {'load': pools['load']}, progress=False)
    moved = np.abs(near.networks.load.layers[0][0].numpy() - before).max()
    assert 0 < moved < 1.51e-4  # two steps of Adam, the second half as long
    assert (first.networks.load.layers[0][0].numpy() == before).all()
    for other, tool in ((dataclasses.replace(config, members=1), 'blade'), (config, 'wheel')):
        with pytest.raises(ValueError, match='initial weights are of 2 members for a blade'):
            training.make_field(other, tool, first=first)


def test_a_network_that_became_worse_on_other_runs_stays_as_it_was(capsys):
    first, _, pools = worlds.trained()
    pools = {name: pools[name] for name in ('load', 'surface')}
    held = {'load': pools['load'], 'surface': []}
    wild = dataclasses.replace(worlds.CONFIG, num_steps=3, learning_rate=0.3)
    field = training.make_field(wild, 'blade', first=first)
    training.fit(field, pools, progress=False, held=held)
    assert 'load: ' in (printed := capsys.readouterr().out) and 'stays as it was' in printed
    for name, same in (('load', True), ('surface', False)):  # nothing was held for the surface
        now, was = (getattr(f.networks, name).layers[0][0].numpy() for f in (field, first))
        assert (now == was).all() == same
    fresh = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    training.fit(fresh, {'load': pools['load']}, progress=False, held=held)
    assert 'stays' not in capsys.readouterr().out


def test_inputs_that_say_the_tool_get_noise_of_their_own():
    """The same on all strips; all other inputs, of each strip and side, their own."""
    networks = worlds.trained()[0].networks
    operands = [row.operand for row in networks.inputs.tables.load.rows for _ in range(row.columns)]
    own, sides = np.zeros((4000, 2, len(operands)), np.float32), np.zeros((4000, 2, 2, 13))
    own, sides = training._noise(networks)(np.random.default_rng(0), own, sides.astype(np.float32))
    edge, soil = (own[..., operands.index(name)] for name in ('radius', 'friction'))
    assert edge.std() == pytest.approx(np.hypot(0.05, 0.02), rel=0.05)
    assert (edge[:, 0] - edge[:, 1]).std() == pytest.approx(0.02 * 2**0.5, rel=0.05)
    assert soil.std() == pytest.approx(0.02, rel=0.05) == sides.std()


def test_the_loss_of_the_mean_of_the_members():
    """Against numpy, on more rows than are computed at a time; beyond a limit errors count by
    their length, so that a few cannot outweigh all others."""
    field, _, pools = worlds.trained()
    part = pools['surface'][0]
    assert len(part.weight) > training.ROWS
    rise = field.networks.moved_of('surface', *part.inputs).numpy().mean(axis=0)
    square = ((rise - part.target) * 20.0) ** 2 * part.weight
    limit = float(np.quantile(square, 0.7))
    far = np.where(square < limit, square, 2 * np.sqrt(limit * square) - limit)
    for of, expected in ((0.0, square), (limit, far)):
        found = training.loss_of(
            lambda x, _: field.networks.moved_of('surface', *x), 20.0, of, [part]
        )
        assert found == pytest.approx(expected.sum() / part.weight.sum(), rel=1e-4)
    assert far.sum() < 0.9 * square.sum()


def test_where_a_bucket_lifts_it_is_faster_than_tools_go_in_the_soil():
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    way = worlds.path(3)[:30]
    up = np.linspace(way[-1], way[-1] + [0.0, 0.2, 0.2], 21)[1:]
    run = worlds.run(3, way=np.concatenate([way, up]))
    bucket = run._replace(tool=dataclasses.replace(run.tool, bucket=1.0))
    names = field.judged_names
    for each, counts in ((run, True), (bucket, False)):
        seen = np.concatenate(training.parts_of_run(field, each, copies=False)[0])
        for name in ('speed', 'along'):
            assert (seen[:, names.index(name)].max() > 0.05) == counts
        assert seen[:, names.index('depth')].max() > 0.01
