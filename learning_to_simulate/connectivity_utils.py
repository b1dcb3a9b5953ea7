"""The edges of the graph, built once per scene and never per step: masks bool [V, V], entry
[receiver, sender].

Edges come from a rule: fully connected, or Algorithm 2 of Usmani & Skonieczny 2023, whose mode
block is found elsewhere (`edge_lists`). Node order is R rigid particles, then r modes.
"""

import numpy as np

from learning_to_simulate.scene import RigidMotion, Scene


def algorithm2(scene: Scene, n_rigid: int, mode_mask: np.ndarray) -> np.ndarray:
    """The partial graph of Usmani & Skonieczny 2023, Algorithm 2.

    modes -> modes as in `mode_mask`, bool [r, r], entry [receiver, sender] (of an NRI result, or of
    any other edge list); rigid -> modes all; modes -> rigid only where the motion of the body is
    (at least in part) predicted; rigid -> rigid along `scene.rigid_edges` only where all of it is
    predicted. ValueError if the mask is not r x r, or a geometry edge names a rigid particle beyond
    R.
    """
    r = scene.n_modes
    if mode_mask.shape != (r, r):
        raise ValueError(f'the mode mask is {mode_mask.shape}, the scene has {r} modes')
    mask = np.zeros((n_rigid + r, n_rigid + r), bool)
    mask[n_rigid:, n_rigid:] = mode_mask
    mask[n_rigid:, :n_rigid] = True
    if scene.rigid_motion in (RigidMotion.PREDICTED, RigidMotion.DRIVEN):
        mask[:n_rigid, n_rigid:] = True
    if scene.rigid_motion == RigidMotion.PREDICTED:
        for sender, receiver in scene.rigid_edges:
            if not (0 <= sender < n_rigid and 0 <= receiver < n_rigid):
                raise ValueError(
                    f'rigid edge {sender} -> {receiver} is outside the {n_rigid} rigid particles'
                )
            mask[receiver, sender] = True
    return mask


def nearest_neighbour_edges(points) -> tuple[tuple[int, int], ...]:
    """Directed edges to every rigid particle from its two nearest others, for folders that state
    none; `points` are [R, D] of one frame, m.

    On a wheel of two rings these are the two neighbours on a particle's own ring, as in the thesis,
    unless the rings stand closer together than the particles of a ring.
    """
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    nearest = np.argsort(distance, axis=1, kind='stable')[:, :2]
    return tuple((int(s), r) for r in range(len(points)) for s in nearest[r])


def mode_correlations(velocities) -> np.ndarray:
    """One-frame-lagged velocity correlation of every pair of modes, float64 [r, r] in [0, 1], entry
    [receiver, sender]: how well the sender's velocity of one frame goes with the receiver's of the
    next, sign ignored. Of velocities [S, T, r, D] on training runs, m/frame, or a list of such
    arrays."""
    parts = velocities if isinstance(velocities, list) else [velocities]
    frames = np.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts])
    mean, scale = frames.mean(axis=0), frames.std(axis=0)
    units = [(part - mean) / np.where(scale > 0, scale, 1.0) for part in parts]
    count = sum(unit[:, 1:, 0].size for unit in units)
    score = sum(np.einsum('stid,stjd->ij', unit[:, 1:], unit[:, :-1]) for unit in units)
    return np.clip(np.abs(score) / max(count, 1), 0.0, 1.0)


def build(kind: str, scene: Scene, n_rigid: int, mode_mask=None, loaded_mask=None) -> np.ndarray:
    """The mask for a graph of R rigid particles and r modes of a scene, of a kind of
    `TrainConfig.adjacency`: 'fully_connected' (all V² edges, self-edges included, as in Haeri &
    Skonieczny 2021) and 'none' need no mask, a `mode_mask` bool [r, r] is completed by Algorithm 2,
    a `loaded_mask` bool [V, V] is used as it is (ValueError where it does not fit V)."""
    n_node = n_rigid + scene.n_modes
    if kind in ('fully_connected', 'none'):
        return np.full((n_node, n_node), kind != 'none')
    if mode_mask is not None:
        return algorithm2(scene, n_rigid, mode_mask)
    if len(loaded_mask) == n_node:
        return loaded_mask
    raise ValueError(
        f'the mask of {kind} is {len(loaded_mask)} x {len(loaded_mask)}, but this dataset has '
        f'graphs of {n_node} nodes ({n_rigid} rigid + {scene.n_modes} modes): give a mask of '
        f'{n_node} or of {scene.n_modes} nodes'
    )
