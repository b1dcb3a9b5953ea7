"""The one timer, on a clock that the test turns."""

import pytest

from reports import timing


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still unless a call turns it on by its own number of seconds."""
    now = [0.0]
    monkeypatch.setattr(timing.time, 'perf_counter', lambda: now[0])
    monkeypatch.setattr(timing.time, 'process_time', lambda: 2 * now[0])
    return now


def test_calls_take_turns_after_their_warm_up(clock):
    order = []

    def job(name, seconds, **options):
        def call():
            order.append(name)
            clock[0] += seconds

        return timing.Job(call, **options)

    jobs = {'a': job('a', 0.5, steps=5, warm_up=1), 'b': job('b', 2.0, rounds=1, warm_up=2)}
    found = timing.in_turns(jobs, 3)
    assert ''.join(order) == 'abb' + 'ab' + 'a' + 'a'
    assert found['a'].samples_ms == pytest.approx((100.0,) * 3)
    assert found['a'].processor_ms == pytest.approx((200.0,) * 3)
    assert found['b'].samples_ms == pytest.approx((2000.0,))


def test_calls_may_time_themselves(clock):
    jobs = {'one': timing.Job(lambda: 0.25, steps=10), 'many': timing.Job(lambda: [0.1, 0.3])}
    found = timing.in_turns(jobs, 2)
    assert found['one'].samples_ms == pytest.approx((25.0, 25.0))
    assert found['many'].samples_ms == pytest.approx((100.0, 300.0) * 2)
    assert found['many'].processor_ms == ()


def test_a_clock_that_stands_still_is_refused(clock):
    with pytest.raises(ValueError, match='positive samples'):
        timing.in_turns({'a': timing.Job(lambda: None)}, 1)
