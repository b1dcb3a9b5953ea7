"""What the three networks of a soil field learn from: inputs, gates and targets of runs.

All inputs follow from terrain and path, so they are computed once. Each run counts alike, whatever
it moves or weighs, from `LEAST_MOTION` and `LEAST_FORCE` on. Of places and particles a part is
drawn in each frame, more of those that move; each drawn one is weighted by how many it was drawn
from.
"""

from typing import NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.network import placed
from learning_to_simulate.soil_field.passage import Passage
from learning_to_simulate.soil_field.place import BESIDE
from learning_to_simulate.soil_field.runs import Run

# A run of a tool that moves less than this (root mean square, m of the field) is weighted as if it
# moved so far, else dents would count like heaps; one that feels less force, N of the field,
# likewise.
LEAST_MOTION, LEAST_FORCE = {'blade': 0.01, 'wheel': 0.003}, 5.0
MOVED = 0.001  # m of the field, of what moves
DRAWN = 48  # places or particles of a frame
START_EVERY = 64  # frames between the starts of episodes
EPISODE = 128  # frames of one that begins in the middle of a run
SETTLED = 0.05  # m of the field, way after which (7) holds nothing of where an episode began
BATCH = 128  # frames


class Part(NamedTuple):
    """Samples of one network.

    Attributes:
      inputs: arrays [S, ...] that it takes, see `SoilNetworks.load_of` and so on.
      target: [S, ...].
      weight: [S], of squared errors.
    """

    inputs: tuple
    target: np.ndarray
    weight: np.ndarray


def loads_of(run: Run, place) -> np.ndarray:
    """Measured force and torque [T, 6] along, up, across of the field, N and N m."""
    force, torque = (np.asarray(v, np.float64) @ place.axes.T for v in (run.force, run.torque))
    return np.concatenate([force, torque], axis=1) / run.tool.units(run.soil)


def walk(run: Run, start: int = 0):
    """Yields number and `Passage` of all frames from one on, a multiple of the stride of heights,
    over the recorded terrain; another passage where it was renewed."""
    terrain = run.terrain(start) if start else run.before()
    passage = Passage(terrain, run.tool, run.pose[start], set_down=start == 0, lays=False)
    yield start, passage
    for t in range(start + 1, len(run.pose)):
        if passage.is_due:
            passage = passage.renewed(run.pose[t - 1])
        if not t % run.stride:
            terrain.write(slice(None), run.heights[t // run.stride].ravel())
        passage.step(run.pose[t], run.dt)
        yield t, passage


def until_lifted(run: Run) -> Run:
    """The run of a bucket up to where it has dug and is lifted: what it holds from there on is not
    for the networks. Runs of other tools as they are."""
    if not getattr(run.tool, 'bucket', 0.0):
        return run
    for t, passage in walk(run):
        if passage.is_over:
            maps = t // run.stride + 1
            frames = slice((maps - 1) * run.stride + 1)
            return run._replace(
                pose=run.pose[frames], force=run.force[frames], torque=run.torque[frames],
                heights=run.heights[:maps], machine=None,
                particles=None if run.particles is None else run.particles[:maps],
            )  # fmt: skip
    return run


class Episode(NamedTuple):
    """A run from one of its frames on.

    Attributes:
      frames: `Frame` of [T, ...].
      passage: at the end.
      risen: of each frame with heights its number in `frames`, the origin's places [K, 2] of cells
        and how far they have risen [K] since the episode began, m of the field.
      loads: [T, 6], see `loads_of`.
      settled: [T], whether the memory is that of the run.
    """

    frames: sweep.Frame
    passage: Passage
    risen: list
    loads: np.ndarray
    settled: np.ndarray


def starts_of(run: Run) -> range:
    """The frames, multiples of the stride of its heights, from which episodes of a run begin."""
    return range(0, max(len(run.pose) - 2 * run.stride, 1), START_EVERY - START_EVERY % run.stride)


def episode_of(run: Run, start: int = 0, whole: Episode | None = None) -> Episode:
    """The whole run, or frames from the middle of it: the tool stands in the soil as it was
    recorded, which it has not moved, so a field learns to go on from any terrain. There it has the
    memory of the way so far, and goes on until a passage is renewed, where the `whole` of its run
    is given; else it has none, and goes on for `EPISODE` frames."""
    frames, risen, ways = [], [], []
    last, settled = (start + EPISODE, SETTLED) if start and whole is None else (len(run.pose), 0.0)
    for t, passage in walk(run, start):
        if t == start and whole is not None:
            path = whole.frames.scalars[t, 0, : len(sweep.SCALARS)].astype(np.float64)
            memory = path[-len(sweep.MEMORIES) * len(sweep.MOTIONS) :]
            speed = path[sweep.SCALARS.index('speed')]
            passage.remember(memory.reshape(len(sweep.MEMORIES), -1), speed)
        frames.append(passage.frame)
        ways.append(passage.state.way)
        if not t % run.stride:
            cells, places, before = passage.surroundings()
            now = run.heights[t // run.stride].ravel()[cells]
            risen.append((t - start, places, (now - before) / passage.scale))
        if t == last or (whole is not None and passage.is_due):
            break
    loads = loads_of(run, passage.place)[start : t + 1]
    frames = _stacked(frames, len(passage.strips.centres))
    return Episode(frames, passage, risen, loads, np.array(ways) >= settled)


def episodes_of(run: Run):
    """Yields the first frame and the `Episode` of the whole run, then of those from its middle."""
    whole = episode_of(run)
    known = whole if np.isfinite(run.tool.renewed_after) else None
    for start in starts_of(run):
        yield start, episode_of(run, start, known) if start else whole


def _stacked(frames, n_strips):
    """`Frame`s one behind the other, those of one strip as that many equal ones: a passage takes
    all strips from where even terrain ends."""
    return sweep.Frame(
        *(np.concatenate([np.repeat(x, n_strips // x.shape[1], axis=1) for x in values])
          for values in zip(*frames, strict=True))
    )  # fmt: skip


def load_part(networks, run: Run, episode: Episode) -> Part:
    """Samples of the load: all frames in which the tool may feel soil."""
    frames = episode.frames
    call = networks.inputs.compiled('load_inputs', frames.bins.shape[1])
    parts = [
        [x.numpy() for x in call(*map(tf.constant, frames.at(slice(i, i + BATCH))))]
        for i in range(0, len(frames.scalars), BATCH)
    ]
    seen, sides, kappa = (np.concatenate(x) for x in zip(*parts, strict=True))
    width = np.full(len(seen), run.tool.width / run.tool.scale, np.float32)
    whole = loads_of(run, episode.passage.place)[:, :2]
    size = max(float(np.sqrt((whole**2).sum(axis=1).mean())), LEAST_FORCE)
    felt = (kappa.max(axis=1) > 0) & episode.settled
    target = episode.loads.astype(np.float32)
    weight = np.full(len(seen), 1.0 / size**2, np.float32)
    return Part(tuple(x[felt] for x in (seen, sides, kappa, width)), target[felt], weight[felt])


def _drawn(rng, moves):
    """Indices of about `DRAWN` of [K], half of them of those that move, and for how many each of
    them stands."""
    chosen, stands = [], []
    for group in (np.flatnonzero(moves), np.flatnonzero(~moves)):
        if len(group):
            some = rng.choice(group, min(len(group), DRAWN // 2), replace=False)
            chosen.append(some)
            stands.append(np.full(len(some), len(group) / len(some)))
    return np.concatenate(chosen), np.concatenate(stands)


def motion_of(episode: Episode) -> float:
    """Root mean square by which the surface has risen, m of the field."""
    return float(np.sqrt(np.mean(np.concatenate([rise for *_, rise in episode.risen]) ** 2)))


def surface_part(networks, episode: Episode, motion: float, rng) -> Part:
    """Samples of the surface; `motion` is that of the whole run."""
    rows, motion = [], max(motion, LEAST_MOTION[networks.tool.name])
    for t, places, rise in episode.risen[1:]:
        chosen, stands = _drawn(rng, np.abs(rise) > MOVED)
        frame = episode.frames.at(slice(t, t + 1))
        seen = _seen(networks, 'surface', frame, episode.passage.strips, places[chosen])
        weight = stands / len(rise) / motion**2
        rows.append((*seen, rise[chosen], weight))
    return _part(rows)


def soil_part(networks, run: Run, rng) -> Part:
    """Samples of particles, of episodes none of which is longer than the bins reach."""
    rows: list = []
    for start in starts_of(run):
        steps = walk(run, start)
        _, passage = next(steps)
        origin = passage.state.origin
        local = passage.place.local(np.asarray(run.particles)) / passage.scale
        rest = local[start // run.stride]
        reach = run.tool.width / passage.scale / 2 + BESIDE
        near = np.abs(rest[:, 2]) < reach
        for t, now in steps:
            if now is not passage or passage.state.origin != origin:
                break
            if t % (2 * run.stride):
                continue
            moved = local[t // run.stride] - rest
            chosen, stands = _drawn(rng, (np.abs(moved).max(axis=1) > MOVED) & near)
            places = rest[chosen] - [origin, passage.level, 0.0]
            seen = _seen(networks, 'soil', passage.frame, passage.strips, places)
            rows.append((*seen, moved[chosen], stands / len(rest)))
    part = _part(rows)
    total = part.weight.sum() or 1.0  # of a tool that is clear of all particles
    motion = np.sqrt((part.weight[:, None] * part.target**2).sum() / total)
    least = LEAST_MOTION[run.tool.name]
    return part._replace(weight=part.weight / max(motion, least) ** 2)


def _seen(networks, name, frame, strips, places):
    """What the network of surface or soil sees of places of one frame, and its gates."""
    call = networks.inputs.compiled(f'{name}_inputs', len(strips.centres))
    return [x.numpy()[0] for x in call(*map(tf.constant, frame), *placed(strips, places))]


def _part(rows):
    seen, gate, target, weight = (
        np.concatenate(x).astype(np.float32) for x in zip(*rows, strict=True)
    )
    felt = gate.reshape(len(gate), -1).max(axis=1) > 0
    return Part((seen[felt], gate[felt]), target[felt], weight[felt])
