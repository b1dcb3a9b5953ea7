"""The one timer, on a clock that the test turns."""

import numpy as np
import pytest

from reports import timing


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still unless a call turns it on by its own number of seconds."""
    now = [0.0]
    monkeypatch.setattr(timing.time, 'perf_counter', lambda: now[0])
    monkeypatch.setattr(timing.time, 'process_time', lambda: 2 * now[0])
    return now


def test_calls_take_turns_after_their_warm_up_and_may_time_themselves(clock):
    order = []

    def job(name, seconds, **options):
        def call():
            order.append(name)
            clock[0] += seconds

        return timing.Job(call, **options)

    jobs = {'a': job('a', 0.5, steps=5), 'b': job('b', 2.0)}
    jobs |= {'own': timing.Job(lambda: 0.25, steps=10), 'many': timing.Job(lambda: [0.1, 0.3])}
    found = timing.in_turns(jobs, 2)
    assert ''.join(order) == 4 * 'ab'
    assert found['a'].clock == pytest.approx((100.0,) * 2)
    assert found['a'].processor == pytest.approx((200.0,) * 2)
    assert found['b'].clock == pytest.approx((2000.0,) * 2)
    assert found['own'].clock == pytest.approx((25.0, 25.0))
    assert found['many'].clock == pytest.approx((100.0, 300.0) * 2)
    assert not len(found['many'].processor)


def test_every_pose_after_the_first_is_a_step_that_is_given_its_context(clock):
    """A step takes 1 s, its particles 2 s."""
    log = []

    class Live:
        dt = 0.5

        def start(self, pose, velocity, **context):
            log.append(('start', pose[0], velocity.tolist(), context))

        def step(self, pose, **context):
            clock[0] += 1
            log.append(('step', pose[0], context))

        def particles(self):
            clock[0] += 2

    poses = np.zeros((5, 7))
    poses[:, 0], poses[:, 1] = 2.0, np.arange(5)
    assert timing.stepping(Live(), poses) == [1.0] * 4
    # It starts with the speed of the path, 1 m in 0.5 s.
    assert log == [('start', 2.0, [0.0, 2.0, 0.0], {})] + 4 * [('step', 2.0, {})]
    assert timing.stepping(Live(), poses, np.arange(5.0), has_particles=True) == [3.0] * 4
    assert [entry[-1]['context'] for entry in log[5:]] == [0.0, 1.0, 2.0, 3.0, 4.0]
