"""`CStep`: frames of a model by the C library, a back end of a `stepping.Stepper`."""

import ctypes

import numpy as np

from learning_to_simulate.export_c import c_library, c_values, model_data
from learning_to_simulate.export_c.c_soil import CSoil


class CStep:
    """The same frames as `compiled_step.CompiledStep`, to round-off, without TensorFlow.

    Args:
      model: `subspace_model.Model`; its weights are taken as they are now.
      n_rigid: R, rigid particles that are nodes.
      rigid_correction: whether a predicted body is kept rigid.

    Raises:
      ValueError: a model that has no C form.
      c_library.NoCompiler, c_library.CompileFailed: as `c_library.load`.
    """

    def __init__(self, model, n_rigid: int, rigid_correction: bool = True):
        values = model_data.values(model, n_rigid, rigid_correction=rigid_correction)
        self._data = c_values.Structure('lts_model', values)
        address = ctypes.addressof(self._data.value)
        self._soil, self._before = (CSoil(c_library.load(), address) for _ in range(2))
        self._is_proposed = False

    @property
    def traces(self) -> int:
        """1, as of a function that is compiled once."""
        return 1

    def reset(self, history, context) -> None:
        """Starts after the frames float64 [H, V, 3], with a context float64 [C] or None."""
        self._soil.reset(history, context)
        self._is_proposed = False

    def prepare(self) -> None:
        """Computes all of the coming frame that needs no pose, so that `propose` answers sooner."""
        if not self._is_proposed:
            self._soil.prepare()

    def propose(self, body, displacement, context=None):
        """The next frame; the state stays as it is until `accept`.

        Args:
          body: float64 [R, 3], m, the body in the coming frame, or None where it is predicted.
          displacement: not needed: the library knows the body of before.
          context: float64 [C] from that frame on; None leaves it as it was.

        Returns:
          float64 [V, 3] positions, m, and float32 [3] force, N, or None.
        """
        del displacement
        if self._is_proposed:
            self._soil.copy_state(self._before)
        else:
            self._before.copy_state(self._soil)
        self._is_proposed = True
        frame = self._soil.step(body, context)
        return np.concatenate([frame.rigid_pose, frame.modes]), frame.force

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        self._is_proposed = False


def best_step(model, n_rigid: int):
    """A `CStep` where the model and the machine have one, else a `CompiledStep`."""
    try:
        return CStep(model, n_rigid)
    except (ValueError, c_library.NoCompiler):
        from learning_to_simulate.compiled.compiled_step import CompiledStep

        return CompiledStep(model, n_rigid)
