"""`wheel_soil` as a baseline: sinkage, drawbar and torque along the recorded motion of wheels."""

import dataclasses

import numpy as np
from scipy import optimize

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods import open_loop, tool_motion
from learning_to_simulate.methods.wheel_soil import TerrainParameters, WheelMotion, Wheels, drive
from learning_to_simulate.scene import RigidMotion

# Names that a scene's context must have, by which a wheel's load and soil are known.
CONTEXT = ('gravity', 'friction_angle_deg', 'load')
RIM_FRICTION = 0.5
# What `fitted` moves, and how: positive ones as logarithms.
_FITTED = ('k_phi', 'n', 'shear_modulus', 'friction_factor')
_FIT_STEPS = (0.7, 0.2, 0.5, -0.2, 2.0)  # of the fitted values and of the friction exponent
_FIT_STRIDE, _FIT_BINS, _FIT_ITERATIONS = 8, 40, 160


class WheelTerramechanics:
    """The wheel's motion and force along recorded paths; the soil stays still.

    Args:
      scene: what exists; the body must be driven, the context as in `CONTEXT`.
      frame: the way of travel.
      parameters: of the soil.

    Raises:
      ValueError: a scene that is not a wheel's.
    """

    def __init__(self, scene, frame, parameters=TerrainParameters()):  # noqa: B008
        if scene.rigid_motion != RigidMotion.DRIVEN or not set(CONTEXT) <= set(scene.context_names):
            raise ValueError(
                f'Bekker, Wong and Janosi need a driven wheel with the context {CONTEXT}; the body '
                f'is {scene.rigid_motion}, its context {scene.context_names}'
            )
        self.scene, self.frame, self.parameters = scene, frame, parameters

    def parameters_to_json(self) -> dict:
        """All but scene and frame, for `from_json`."""
        return dataclasses.asdict(self.parameters)

    @classmethod
    def from_json(cls, values: dict, scene, frame) -> 'WheelTerramechanics':
        """Rebuilds a method; raises TypeError or ValueError on foreign values."""
        return cls(scene, frame, TerrainParameters(**{k: float(v) for k, v in values.items()}))

    def drive(self, group, cases=None, stride: int = 1, n_bin: int = 160) -> WheelMotion:
        """`WheelMotion` [S, ceil(T / stride)] of the runs of a group."""
        body = tool_motion.hidden_height(group.position[:, :, : group.n_rigid], self.scene, H)
        centre, turned, radius, width = tool_motion.wheel_pose(body, self.frame)
        gravity, angle, load = (
            group.context[..., self.scene.context_names.index(name)] for name in CONTEXT
        )
        if load.ndim == 2:  # soil and planet stay, the load may change
            gravity, angle, load = gravity[:, 0], angle[:, 0], load[:, ::stride]
        rim = [(c or {}).get('body_friction', RIM_FRICTION) for c in cases or [None] * len(load)]
        wheels = Wheels(radius, width, load, gravity, np.tan(np.radians(angle)), np.array(rim))
        travel = centre[..., 0] - centre[:, :1, 0]
        rolled = radius[:, None] * turned
        return drive(wheels, travel[:, ::stride], rolled[:, ::stride], self.parameters, n_bin)

    def predict(self, group, cases=None) -> open_loop.Prediction:
        """Frames H .. T - 1 of the S runs of a group.

        The height goes on from the last given one, by the change of the sinkage since.

        Args:
          group: `RunGroup`.
          cases: per run, its entry in the metadata's `cases`; only `body_friction` is read.
        """
        motion = self.drive(group, cases)
        up = self.scene.up_axis
        start = group.position[:, H - 1, : group.n_rigid, up].mean(axis=1)[:, None]
        height = start - (motion.sinkage[:, H:] - motion.sinkage[:, H - 1 : H])
        force = self._force(motion)[:, H:]
        predicts = frozenset({open_loop.FORCE, open_loop.HEIGHT, open_loop.TORQUE})
        position = open_loop.held_position(group, self.scene, height)
        return open_loop.Prediction(position, force, predicts, self._torque(motion)[:, H:])

    def _force(self, motion):
        force = np.zeros((*motion.drawbar.shape, 3))
        force[..., self.frame.axis] = self.frame.sign * motion.drawbar
        force[..., self.frame.up] = motion.vertical
        return force

    def _torque(self, motion):
        # Rolling along +u turns u towards -y; the soil turns it back.
        axle = np.cross(np.eye(3)[self.frame.up], self.frame.sign * np.eye(3)[self.frame.axis])
        return -motion.torque[..., None] * axle

    def fitted(self, groups, cases=None) -> 'WheelTerramechanics':
        """The same with k_phi, n, K, the friction factor and the friction exponent that fit the
        runs of the groups best (Nelder-Mead on every eighth frame).

        The error is the mean over runs of the force's relative L2 error and of the height's RMS
        error over the RMS of the height's change in all runs.
        """
        cases = cases or [None] * len(groups)
        up = self.scene.up_axis
        truth = []
        for group in groups:
            height = group.position[:, :, : group.n_rigid, up].mean(axis=2)[:, ::_FIT_STRIDE]
            truth.append((height - height[:, :1], group.force[:, ::_FIT_STRIDE]))
        moved = np.sqrt(np.mean(np.concatenate([h.reshape(-1) for h, _ in truth]) ** 2))

        def error(values):
            method = WheelTerramechanics(self.scene, self.frame, self._with(values))
            errors = []
            for group, of_group, (height, force) in zip(groups, cases, truth, strict=True):
                motion = method.drive(group, of_group, _FIT_STRIDE, _FIT_BINS)
                sunk = motion.sinkage[:, :1] - motion.sinkage - height
                off = method._force(motion) - force
                errors.append(np.sqrt((sunk**2).mean(axis=1)) / max(moved, 1e-9))
                errors.append(np.sqrt((off**2).sum(axis=(1, 2)) / (force**2).sum(axis=(1, 2))))
            return float(np.concatenate(errors).mean())

        start = [np.log(getattr(self.parameters, name)) for name in _FITTED]
        start.append(self.parameters.friction_exponent)
        simplex = np.array(
            [start] + [np.array(start) + s for s in np.diag([0.7, 0.2, 0.5, -0.2, 2])]
        )
        found = optimize.minimize(
            error,
            start,
            method='Nelder-Mead',
            options={'maxfev': _FIT_ITERATIONS, 'initial_simplex': simplex},
        )
        return WheelTerramechanics(self.scene, self.frame, self._with(found.x))

    def _with(self, values):
        changed = {name: float(np.exp(v)) for name, v in zip(_FITTED, values[:-1], strict=True)}
        return dataclasses.replace(self.parameters, **changed, friction_exponent=float(values[-1]))
