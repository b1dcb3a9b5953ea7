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


def by_c(model, starts, subspace, make=CSubspace.of, **options) -> Stepper:
    """A stepper by C; `make` makes the `CSubspace` of (model, R)."""
    found = Stepper(
        model, starts, subspace, make_step=lambda *of: CStep(make(*of)), **options
    )  # fmt: skip
    found.engine = f'C ({found.computing.name})'
    return found


class CStep:
    """A step of `Stepper` by the C library: the same frames as `live.tf_step.TfStep`."""

    def __init__(self, soil: CSubspace):
        self._soil, self._before = soil, soil.another()
        self._is_proposed = False

    @property
    def name(self) -> str:
        """The instructions that run."""
        return self._soil.kernel

    def reset(self, history, context) -> None:
        """As of `TfStep`."""
        self._soil.reset(history, context)
        self._is_proposed = False

    def propose(self, body, displacement, context=None):
        """As of `TfStep`; the displacement is not needed: the library keeps the body of the last
        frame."""
        del displacement
        if self._is_proposed:
            self._soil.copy_state(self._before)
        else:
            self._before.copy_state(self._soil)
        self._is_proposed = True
        frame = self._soil.step(body, context)
        return np.concatenate([frame.rigid_pose, frame.modes]), frame.force

    def particles(self) -> np.ndarray:
        """float32 [N, 3], m, of the frame that was computed last, as the library decodes them."""
        return self._soil.particles()

    def accept(self) -> None:
        self._is_proposed = False

    @property
    def state(self) -> bytes:
        return (self._before if self._is_proposed else self._soil).save()

    @state.setter
    def state(self, state: bytes) -> None:
        self._soil.load_state(state)
        self._is_proposed = False
