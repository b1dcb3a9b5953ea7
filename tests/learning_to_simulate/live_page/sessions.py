"""Sessions of the shipped models, shared by the tests of the live page."""

import functools

import learning_to_simulate as lts
from learning_to_simulate.live_page import recorded, session


@functools.cache
def model(name):
    return lts.load(name)


@functools.cache
def runs(name):
    found = recorded.of_model(model(name))
    assert found is not None, 'the shipped dataset fits its model'
    return found


def make(name):
    return session.Session(model(name), runs(name))
