"""Who computes the frames of a `live.stepper.Stepper`: C where model and machine have it, else
TensorFlow, which then says why.

C gives the frames of TensorFlow to round-off.
"""

import numpy as np

from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import library
from learning_to_simulate.native.binding import CSubspace

BEST, C, TENSORFLOW = KINDS = 'best', 'c', 'tensorflow'


def chosen(kind: str, by_c, by_tensorflow):
    """`by_c()`, or `by_tensorflow(why)` with what keeps this machine from C ('' where nobody
    asked); errors as of `stepper`."""
    if kind not in KINDS:
        raise ValueError(f'engine is {kind!r}, must be one of {KINDS}')
    why = ''
    if kind != TENSORFLOW:
        try:
            return by_c()
        except (ValueError, library.NoCompiler) as error:
            if kind == C:
                raise
            why = f' ({str(error).splitlines()[0]})'
    return by_tensorflow(why)


def stepper(model, starts=None, subspace=None, kind: str = BEST, **options) -> Stepper:
    """A stepper of a `subspace_model.Model` with starts and subspace of `live.starts.read`; options
    `n_rigid` and `outside` of `Stepper`, whose errors this raises.

    Raises:
      ValueError: an unknown kind (of 'best', 'c', 'tensorflow'); with 'c' a model without a C form.
      library.NoCompiler: with 'c', where there is no compiler.
    """

    def by_tensorflow(why):
        found = Stepper(model, starts, subspace, **options)
        found.engine += why
        return found

    return chosen(kind, lambda: by_c(model, starts, subspace, **options), by_tensorflow)


class CStep(CSubspace):
    """A step of `Stepper` by the C library: the same frames as `live.stepper.TfStep`."""

    _before: 'CStep | None' = None  # the state that a proposal left behind
    _is_proposed = False

    def reset(self, history, context=None) -> None:
        """As of `TfStep`."""
        super().reset(history, context)
        self._is_proposed = False

    def propose(self, body, displacement, context=None):
        """As of `TfStep`; the displacement is not needed: the library keeps the body of the last
        frame."""
        del displacement
        if self._before is None:
            self._before = self.another()
        if self._is_proposed:
            self.copy_state(self._before)
        else:
            self._before.copy_state(self)
        self._is_proposed = True
        frame = self.step(body, context)
        return np.concatenate([frame.rigid_pose, frame.modes]), frame.force

    def accept(self) -> None:
        self._is_proposed = False

    def clone(self) -> 'CStep':
        """As of `TfStep`."""
        other = self.another()
        other.copy_state(self._before if self._is_proposed and self._before else self)
        return other


def by_c(model, starts, subspace, make=CStep.of, **options) -> Stepper:
    """A stepper by C; `make` makes the `CStep` of (model, R)."""
    found = Stepper(model, starts, subspace, make_step=make, **options)
    found.engine = f'C ({found.computing.kernel})'
    return found
