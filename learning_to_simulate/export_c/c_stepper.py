"""`CStepper`: live stepping by the C library, with the behaviour of `stepping.Stepper`.

Example:
    stepper = CStepper.load('models/excavation/pcg', 'datasets/excavation')
    stepper.reset(history)                          # [6, R + r, 3], the last six frames
    while running:
        stepper.prepare()                           # while waiting for the pose
        frame = stepper.step(next_blade_points)     # [R, 3], where the blade will be
        draw(stepper.particles(), frame.rigid_pose, frame.force)

The library is compiled once per machine; a stepper is made without compiling.
"""

import ctypes

from learning_to_simulate.export_c import c_library, c_values, model_data
from learning_to_simulate.export_c import starts as recorded_starts
from learning_to_simulate.export_c.c_soil import CSoil
from pca_tools.subspace import Subspace


class CStepper(CSoil):
    """Steps a trained model frame by frame, without TensorFlow.

    Args:
      model: `subspace_model.Model`; its weights are taken as they are now.
      n_rigid: R, rigid particles that are nodes.
      subspace: turns modes into particles; None if particles are never asked for.
      rigid_correction: whether a predicted body is kept rigid.
      starts: of `starts.read`, for `start`.
      kernel: 'best' or one of `c_instance.KERNELS`.

    Raises:
      ValueError: a model that has no C form, a subspace of another number of modes or particles
        than the model's, a body that it cannot take, a kernel that this machine lacks.
      c_library.NoCompiler, c_library.CompileFailed: as `c_library.load`.
    """

    def __init__(
        self,
        model,
        n_rigid: int,
        subspace: Subspace | None = None,
        rigid_correction: bool = True,
        starts=(),
        kernel: str = 'best',
    ):
        values = model_data.values(model, n_rigid, subspace, rigid_correction, starts)
        self._data = c_values.Structure('lts_model', values)
        super().__init__(c_library.load(), ctypes.addressof(self._data.value), kernel)

    @classmethod
    def load(cls, model_path: str, data_path: str, n_rigid: int | None = None, **options):
        """A stepper of a model folder and the dataset folder it belongs to.

        Args:
          model_path: of `subspace_model.load`.
          data_path: its metadata, its training runs' starts and, if it has one, its subspace.
          n_rigid: R; default: that of the model's first training run.
          **options: of the constructor.

        Raises:
          FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
        """
        model, n_rigid, subspace, found = recorded_starts.read_model(model_path, data_path, n_rigid)
        return cls(model, n_rigid, subspace, **{'starts': found} | options)
