"""The one timer: calls take turns after a warm-up, so a drift of the machine meets them all."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import tqdm

WARM_UP = 2  # calls before


class Timing(NamedTuple):
    """Samples of one job, ms per step, in the order of measurement."""

    clock: np.ndarray  # by the clock on the wall
    # By processor time of all threads, where it was taken: on a busy machine it says more.
    processor: np.ndarray


@dataclasses.dataclass(frozen=True)
class Job:
    """Something to be timed."""

    # Does it once, results materialised. If it returns numbers, these are the seconds: one call may
    # time only a part of what it does, or many steps each by itself.
    call: Callable[[], object]
    steps: int = 1  # what the time of a call is divided by


def in_turns(jobs: Mapping[Any, Job], rounds: int) -> dict[Any, Timing]:
    """Times all jobs, one call of each in every round; ValueError: a job took, or returned, a time
    that is not above 0."""
    seconds: dict[Any, list] = {name: [] for name in jobs}
    processor: dict[Any, list] = {name: [] for name in jobs}
    for turn in tqdm.tqdm(range(-WARM_UP, rounds), 'in turns', unit='round', disable=None):
        for name, job in jobs.items():
            wall, busy = time.perf_counter(), time.process_time()
            result = job.call()
            wall, busy = time.perf_counter() - wall, time.process_time() - busy
            if turn < 0:
                continue
            if isinstance(result, int | float | list | tuple):
                seconds[name] += np.ravel(result).tolist()
            else:
                seconds[name].append(wall)
                processor[name].append(busy)
    found = {}
    for name, job in jobs.items():
        found[name] = Timing(*(1e3 * np.array(s[name]) / job.steps for s in (seconds, processor)))
        if not len(found[name].clock) or not (found[name].clock > 0).all():
            raise ValueError(f'{name}: times are positive, got {found[name].clock[:5]} ms')
    return found


def stepping(live, poses: np.ndarray, contexts=None, has_particles: bool = False) -> list[float]:
    """`steps` of a model in the subspace, which starts at the first of the poses [T, 7] with the
    speed of the path, under contexts [T, C] if any."""
    given = [{}] * len(poses) if contexts is None else [{'context': c} for c in contexts]
    live.start(poses[0], velocity=(poses[1] - poses[0])[:3] / live.dt, **given[0])
    return steps(live, poses[1:], given[1:], has_particles)


def steps(live, poses, given=None, has_particles: bool = False) -> list[float]:
    """Seconds of every step of a stepper that has started, along poses [T, 7], with further
    arguments of each step if `given`: of a step and its force, or of all particles, too."""
    seconds = []
    for pose, arguments in zip(poses, given or [{}] * len(poses), strict=True):
        start = time.perf_counter()
        live.step(pose, **arguments)
        if has_particles:
            live.particles()
        seconds.append(time.perf_counter() - start)
    return seconds
