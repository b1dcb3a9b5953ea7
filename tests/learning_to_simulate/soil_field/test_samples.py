"""What networks learn from, against the arrays of a run."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate.soil_field import samples, training
from learning_to_simulate.soil_field.tools import Soil
from tests.learning_to_simulate.soil_field import worlds


def test_loads_are_in_the_axes_and_units_of_the_field():
    run = worlds.run(3)._replace(soil=Soil(density=2 * 1730.61, gravity=9.81 / 4))
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    part = samples.load_part(field.networks, run, samples.episode_of(run))
    depth = np.maximum(worlds.TOOL.radius - worlds.path(3)[:, 1], 0.0)
    kappa = part.inputs[2]
    assert len(part.target) == len(depth) and (kappa > 0).all()  # never far above the soil
    np.testing.assert_allclose(part.target[:, :3], 2 * depth[:, None] * worlds.DEPTH, atol=1e-3)
    np.testing.assert_allclose(part.target[:, 5], 60 * depth, rtol=1e-5, atol=1e-5)
    size = np.sqrt((part.target[:, :2] ** 2).sum(axis=1).mean())
    np.testing.assert_allclose(part.weight, 1 / size**2, rtol=1e-5)


def test_drawn_places_stand_for_all():
    rng = np.random.default_rng(0)
    moves = np.arange(1000) < 130
    chosen, stands = samples._drawn(rng, moves)
    assert len(set(chosen)) == 48 and moves[chosen].sum() == 24
    assert stands[moves[chosen]].sum() == pytest.approx(130) and stands.sum() == pytest.approx(1000)
    few, stands = samples._drawn(rng, np.arange(1000) < 3)
    assert stands.sum() == pytest.approx(1000) and np.isin([0, 1, 2], few).all()


def test_targets_are_what_the_run_shows():
    run = worlds.run(2)
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    whole = samples.episode_of(run)
    passage = whole.passage
    t, places, rise = whole.risen[7]
    cells = np.stack([-(places[:, 0] + passage.state.origin), -places[:, 1]], axis=1)
    index = np.rint((cells - worlds.CORNER) / worlds.CELL - 0.5).astype(int)
    now = run.heights[t // run.stride][index[:, 0], index[:, 1]]
    np.testing.assert_allclose(rise, now, atol=1e-12)  # the bed was level, at 0
    rng = np.random.default_rng(0)
    surface = samples.surface_part(field.networks, whole, samples.motion_of(whole), rng)
    assert surface.target.min() < -0.02 and surface.target.max() == np.float32(worlds.HEAP)
    soil = samples.soil_part(field.networks, run, rng)
    moved = np.abs(soil.target).max(axis=1) > 1e-4
    np.testing.assert_allclose(soil.target[moved], [[0.02, 0.01, 0.0]] * moved.sum(), atol=1e-6)
    assert moved.any() and not moved.all() and (soil.weight > 0).all()


def test_a_dent_does_not_count_like_a_heap():
    run = worlds.run(2)
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    whole = samples.episode_of(run)

    def weights(motion):
        rng = np.random.default_rng(0)
        return samples.surface_part(field.networks, whole, motion, rng).weight

    np.testing.assert_array_equal(weights(0.001), weights(0.01))
    np.testing.assert_allclose(weights(0.02), weights(0.01) / 4, rtol=1e-6)

    def total(size):  # of squared errors of particles that stay where they were
        moved = run.particles[:1] + size * (run.particles - run.particles[:1])
        rng = np.random.default_rng(0)
        part = samples.soil_part(field.networks, run._replace(particles=moved), rng)
        return (part.weight * (part.target**2).sum(axis=1)).sum()

    assert total(0.5) == pytest.approx(total(1.0) / 4)  # 3 and 6 mm
    assert total(8.0) == pytest.approx(total(4.0))


def test_particles_are_taken_until_the_passage_is_renewed(monkeypatch):
    run = worlds.run(2)
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    monkeypatch.setattr(type(worlds.TOOL), 'renewed_after', 0.12)
    passages = [passage for _, passage in samples.walk(run, 0)]
    assert passages[0].state.origin == 0.0  # its bins had not moved on yet
    assert passages[15] is passages[0] and passages[16] is not passages[0]
    part = samples.soil_part(field.networks, run, np.random.default_rng(0))
    assert 0 < len(part.target) <= 48  # of frame 8 alone


def test_a_walk_sees_the_terrain_as_it_was_recorded():
    run = worlds.run(4)
    steps = samples.walk(run, 24)
    t, passage = next(steps)
    assert t == 24 and (passage.terrain.heights == run.heights[6]).all()
    assert (passage.state.surface == passage.state.profile).all()
    t = [next(steps)[0] for _ in range(5)][-1]
    assert t == 29 and (passage.terrain.heights == run.heights[7]).all()


def test_an_episode_from_the_middle_of_a_run():
    """Its places have risen since it began; its loads count once the memory is that of the run."""
    run = worlds.run(2)
    longer = run._replace(pose=np.repeat(run.pose, 4, axis=0))
    assert list(samples.starts_of(longer)) == [0, 64, 128]
    whole, part = samples.episode_of(run), samples.episode_of(run, 24)
    assert whole.settled.all() and len(part.frames.scalars) == len(run.pose) - 24
    np.testing.assert_array_equal(part.loads, whole.loads[24:])
    t, places, rise = part.risen[-1]
    cells = np.stack([-(places[:, 0] + part.passage.state.origin), -places[:, 1]], axis=1)
    cells = cells + part.passage.place.origin[[0, 2]]
    index = np.rint((cells - worlds.CORNER) / worlds.CELL - 0.5).astype(int)
    risen = (run.heights[(24 + t) // run.stride] - run.heights[6])[index[:, 0], index[:, 1]]
    np.testing.assert_allclose(rise, risen, atol=1e-12)
    assert np.abs(rise).max() > 0.005 and 0 < part.settled.sum() < len(part.settled)
    memory = [i for i, name in enumerate(samples.sweep.SCALARS) if name[-2:] in ('_0', '_1')]
    seen, known = (e.frames.scalars[:, 0, memory] for e in (part, whole))
    np.testing.assert_allclose(seen[part.settled], known[24:][part.settled], atol=1e-4)


def test_an_episode_of_a_tool_whose_passages_are_renewed_has_the_memory_of_the_run():
    way = worlds.path(2, 97) * [3.2, 1.0, 1.0]
    run = worlds.run(2, way=way)
    whole = samples.episode_of(run)
    ways = whole.frames.scalars[:, 0, samples.sweep.SCALARS.index('way')]
    assert len(ways) == 97 and (np.diff(ways) < 0).sum() == 1
    part = samples.episode_of(run, 4, whole)
    n = len(part.loads)
    assert part.settled.all() and 4 + n < 97  # until it is renewed
    np.testing.assert_array_equal(part.loads, whole.loads[4 : 4 + n])
    memory = [samples.sweep.SCALARS.index('along_0'), samples.sweep.SCALARS.index('pace_3')]
    seen, known = (e.frames.scalars[:, 0, memory] for e in (part, whole))
    np.testing.assert_allclose(seen, known[4 : 4 + n], atol=1e-6)


def test_a_bucket_teaches_until_it_is_lifted():
    way = worlds.path(3)[:30]
    up = np.linspace(way[-1], way[-1] + [0.0, 0.2, 0.2], 21)[1:]
    run = worlds.run(3, way=np.concatenate([way, up]))
    bucket = run._replace(tool=dataclasses.replace(run.tool, bucket=1.0))
    assert samples.until_lifted(run) is run
    whole = samples.until_lifted(bucket)
    assert len(whole.pose) == len(whole.force) == len(whole.torque) < len(run.pose)
    assert len(whole.heights) == len(whole.particles) == (len(whole.pose) - 1) // run.stride + 1
    high = run.pose[: len(whole.pose) + run.stride, 1] - run.tool.radius
    assert high[: len(whole.pose)].max() < run.tool.lifted + 0.01 < high[-1] + run.stride * 0.01
    stays = bucket._replace(pose=run.pose[:30], force=run.force[:30], torque=run.torque[:30])
    assert samples.until_lifted(stays) is stays
