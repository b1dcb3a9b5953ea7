"""Kernel ridge regression, and its errors on runs that are left out."""

import dataclasses

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H


@dataclasses.dataclass(frozen=True)
class Regression:
    """One fitted kernel ridge: `y(x) = offset + sum_i dual_i k(x', x'_i)`.

    Attributes:
      inputs: which inputs it sees, a name of `path_inputs.SETS`.
      gamma: width of the kernel on scaled inputs, 1 / (2 length²).
      alpha: ridge.
      shift, scale: [I], x' = (x - shift) / scale.
      samples: [n, I] scaled inputs of training.
      dual: [n, O].
      offset: [O], the mean of training; None where the output is the change since the last given
        frame.
      kernel: a name of `KERNELS`.
    """

    inputs: str
    gamma: float
    alpha: float
    shift: np.ndarray
    scale: np.ndarray
    samples: np.ndarray
    dual: np.ndarray
    offset: np.ndarray | None = None
    kernel: str = 'gaussian'

    @classmethod
    def fit(
        cls, inputs: str, x, y, gamma: float, alphas, kernel: str = 'gaussian'
    ) -> list['Regression']:
        """Fits outputs y [n, O] to inputs x [n, I], once with each ridge and all with one kernel.

        `gamma` is per number of inputs.
        """
        from sklearn.kernel_ridge import KernelRidge  # slow to load, and only fits need it

        shift, scale = _scaling(x)
        parts = (shift, scale, (x - shift) / scale)
        gamma = gamma / x.shape[1]
        gram = gram_matrix(parts[2], parts[2], gamma, kernel)
        return [
            cls(inputs, gamma, alpha, *parts,
                np.asarray(KernelRidge(alpha=alpha, kernel='precomputed').fit(gram, y).dual_coef_),
                kernel=kernel)
            for alpha in alphas
        ]  # fmt: skip

    def columns(self, which: slice, offset) -> 'Regression':
        """The regression of some of the outputs; they share all but the dual coefficients."""
        return dataclasses.replace(
            self, dual=np.ascontiguousarray(self.dual[:, which]), offset=offset
        )

    def predict(self, x) -> np.ndarray:
        """Outputs [S, T - H, O] of frames H .. T - 1 from inputs [S, T, I] of all frames."""
        return self.since_start(self(x[:, H - 1 :]))

    def since_start(self, values) -> np.ndarray:
        """Outputs [S, T - H, O] from what is regressed for frames H - 1 .. T - 1.

        Changes since the last given frame begin there: what is regressed for it is taken off.
        """
        return values[:, 1:] - values[:, :1] if self.offset is None else values[:, 1:] + self.offset

    def gram(self, x) -> np.ndarray:
        """[..., n] of inputs [..., I] and the samples."""
        flat = ((x - self.shift) / self.scale).reshape(-1, x.shape[-1])
        found = gram_matrix(flat, self.samples, self.gamma, self.kernel)
        return found.reshape(*x.shape[:-1], -1)

    def __call__(self, x) -> np.ndarray:
        """Outputs [..., O] at inputs [..., I]."""
        return self.gram(x) @ self.dual

    def check(self) -> None:
        """Refuses arrays that do not fit each other.

        Raises:
          ValueError: they do not.
        """
        n, inputs = self.samples.shape
        if (
            self.shift.shape != (inputs,)
            or self.scale.shape != (inputs,)
            or self.dual.ndim != 2
            or len(self.dual) != n
            or (self.offset is not None and self.offset.shape != self.dual.shape[1:])
            or not all(
                np.isfinite(v).all() for v in (self.shift, self.scale, self.samples, self.dual)
            )
            or not (self.scale > 0).all()
            or self.kernel not in KERNELS
        ):
            raise ValueError('arrays do not fit each other')


def errors_left_out(x, y, run, gamma: float, alphas, kernel: str = 'gaussian') -> list[np.ndarray]:
    """What the samples of each run are off when the others alone are fitted, for each ridge.

    With G = (K + alpha I)^-1 and c = G y, a fit without the samples g is off by G_gg^-1 c_g on
    them (Rasmussen & Williams 2006, 5.12, has it for one sample), so that one eigendecomposition
    serves all runs and ridges.

    Args:
      x: [n, I] inputs, scaled here as `Regression.fit` does.
      y: [n, O] outputs.
      run: int [n], the run of each sample.
      gamma: width per number of inputs.
      alphas: ridges.
      kernel: a name of `KERNELS`.

    Returns:
      of each ridge [n, O].
    """
    shift, scale = _scaling(x)
    scaled = (x - shift) / scale
    values, vectors = np.linalg.eigh(gram_matrix(scaled, scaled, gamma / x.shape[1], kernel))
    along = vectors.T @ y
    found = []
    for alpha in alphas:
        inverse = 1.0 / (np.maximum(values, 0.0) + alpha)
        dual = vectors @ (inverse[:, None] * along)
        errors = np.empty_like(y)
        for g in np.unique(run):
            own = run == g
            block = (vectors[own] * inverse) @ vectors[own].T
            errors[own] = np.linalg.solve(block, dual[own])
        found.append(errors)
    return found


def _scaling(x):
    """Shift and scale [I] of inputs; what does not vary is not blown up."""
    shift, scale = x.mean(axis=0), x.std(axis=0)
    return shift, np.where(scale > 1e-9 * np.maximum(np.abs(shift), 1.0), scale, 1.0)


def gram_matrix(a, b, gamma: float, kernel: str) -> np.ndarray:
    """k(a_i, b_j) [n_a, n_b] of scaled inputs [n, I]; in place, since these are large."""
    square = a @ b.T
    square *= -2.0
    square += (a**2).sum(axis=1)[:, None]
    square += (b**2).sum(axis=1)
    np.maximum(square, 0.0, out=square)
    return KERNELS[kernel](square, gamma)


def _gaussian(square, gamma):
    square *= -gamma
    return np.exp(square, out=square)


def _matern(square, gamma):
    """Matérn's with smoothness 3/2 (Rasmussen & Williams 2006, 4.17)."""
    square *= 6.0 * gamma
    r = np.sqrt(square, out=square)
    return (1.0 + r) * np.exp(-r)


def _exponential(square, gamma):
    """Matérn's with smoothness 1/2."""
    square *= 2.0 * gamma
    r = np.sqrt(square, out=square)
    r *= -1.0
    return np.exp(r, out=r)


# Name -> function of squared distances, which it may overwrite, and gamma; all of one length. The
# rougher, the sooner a regression goes back to the mean away from its samples.
KERNELS = {'gaussian': _gaussian, 'matern': _matern, 'exponential': _exponential}
