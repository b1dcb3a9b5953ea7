"""The motion of a body: what a simulation asks of it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm.bodies import Body


@dataclass(frozen=True)
class Drive:
    """How a body moves in one run.

    Attributes:
        body: the rigid body.
        pose: times [T] (s) -> float64 [T, 3]: x and y (m) of the reference point and the angle
            theta (rad, counter-clockwise about +z; a blade whose top leans back, to +x, by a has
            theta = -a). y is ignored where the height is free. Before time 0 the pose rests
            at its first value.
        load: times [T] (s) -> float64 [T], N on the free vertical motion; None if the height is
            prescribed.
        lead_in: frames that are simulated before the first recorded one: an earlier pass of the
            tool over the bed. Times of `pose` and `load` count from the first simulated frame.
    """

    body: Body
    pose: Callable[[np.ndarray], np.ndarray]
    load: Callable[[np.ndarray], np.ndarray] | None = None
    lead_in: int = 0
