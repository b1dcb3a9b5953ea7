"""Who computes the frames of a `live.stepper.Stepper`: C where model and machine have it, else
TensorFlow, which then says why.

C gives the frames of TensorFlow to round-off.
"""

from learning_to_simulate.live.stepper import Stepper, TfStep
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


def stepper(
    model, starts=None, subspace=None, kind: str = BEST, make_step=TfStep, **options
) -> Stepper:
    """A stepper of a `subspace_model.Model` with starts and subspace of `live.starts.read`, or of
    another model with its `make_step`; options `n_rigid` and `outside` of `Stepper`, whose errors
    this raises.

    Raises:
      ValueError: an unknown kind (of 'best', 'c', 'tensorflow'); with 'c' a model without a C form.
      library.NoCompiler: with 'c', where there is no compiler.
    """

    def by_tensorflow(why):
        found = Stepper(model, starts, subspace, make_step=make_step, **options)
        found.engine += why
        return found

    return chosen(kind, lambda: by_c(model, starts, subspace, **options), by_tensorflow)


def by_c(model, starts, subspace, make=CSubspace.of, **options) -> Stepper:
    """A stepper by C; `make` makes the `CSubspace` of (model, R)."""
    found = Stepper(model, starts, subspace, make_step=make, **options)
    found.engine = f'C ({found.computing.kernel})'
    return found
