"""Load on a tool by three-dimensional resistive force theory: no memory, no learning.

Agarwal, Goldman & Kamrin (2023), PNAS 120(4), e2214017120. A piece of surface at the depth z whose
outward normal n looks where it goes (v, n v > 0) feels

    t = xi z (a_n + min(mu_s |a_n| / |a_t|, 1) a_t),   xi = rho g (894 mu^3 - 386 mu^2 + 89 mu)

with a_n and a_t the normal and the other part of a(beta, gamma): beta is the slope of the surface,
gamma how steeply it goes down, both seen where it goes. With x1 = sin gamma, x2 = cos beta,
x3 = sin(beta + gamma) and cubic polynomials f1, f2, f3 of them (their coefficients are those of the
paper), for motion in the plane of the normal,

    a_along = f1 sin beta + f2 cos gamma,   a_up = -f1 cos beta - f2 sin gamma - f3.

Tools are their outlines: a blade is a plate with a round lower edge, a wheel its rim without
grousers; their ends are left out. Depths count from the terrain right ahead of the tool.
"""

import numpy as np

from learning_to_simulate.baselines import earthmoving, wheel_terramechanics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.soil_field import evaluation, samples
from learning_to_simulate.soil_field.place import place_of

# Of f1, f2, f3: of 1, x1, x2, x3, their squares, x1 x2, x2 x3, x3 x1, their cubes, x1 x2^2,
# x2 x1^2, x2 x3^2, x3 x2^2, x3 x1^2, x1 x3^2, x1 x2 x3.
_POLYNOMIALS = np.array([
    [0.00212, -0.02320, -0.20890, -0.43083, -0.00259, 0.48872, -0.00415, 0.07204, -0.02750,
     -0.08772, 0.01992, -0.45961, 0.40799, -0.10107, -0.06576, 0.05664, -0.09269, 0.01892, 0.01033,
     0.15120],
    [-0.06796, -0.10941, 0.04725, -0.06914, -0.05835, -0.65880, -0.11985, -0.25739, -0.26834,
     0.02692, -0.00736, 0.63758, 0.08997, 0.21069, 0.04748, 0.20406, 0.18589, 0.04934, 0.13527,
     -0.33207],
    [-0.02634, -0.03436, 0.45256, 0.00835, 0.02553, -1.31290, -0.05532, 0.06790, -0.16404, 0.02287,
     0.02927, 0.95406, -0.00131, -0.11028, 0.01487, -0.02730, 0.10911, -0.04097, 0.07881, -0.27519],
])  # fmt: skip
PIECES = 48  # of a face or an arc


def scale(density: float, gravity: float, friction: float) -> float:
    """xi, N/m3, of a soil; `friction` is the tangent of its angle."""
    return density * gravity * (894 * friction**3 - 386 * friction**2 + 89 * friction)


def stress(normal, motion, friction: float) -> np.ndarray:
    """Stress on the tool over xi z, [..., 2] along and up; 0 where a surface goes away from the
    soil. `normal` points out of the tool, `motion` where the surface goes, both [..., 2] of length
    1; `friction` is that between tool and soil."""
    leads = (normal * motion).sum(axis=-1) > 0
    onward = np.where(motion[..., 0] < 0, -1.0, 1.0)  # the axis along that the angles count from
    below = np.where(normal[..., 1] > 0, -1.0, 1.0)  # of both sides of a plate the lower one counts
    sine, cosine = below * onward * normal[..., 0], np.abs(normal[..., 1])
    ahead, down = np.abs(motion[..., 0]), -motion[..., 1]
    a, b, c = down, cosine, ahead * sine + down * cosine
    terms = np.stack([
        np.ones_like(a), a, b, c, a**2, b**2, c**2, a * b, b * c, c * a, a**3, b**3, c**3,
        a * b**2, b * a**2, b * c**2, c * b**2, c * a**2, a * c**2, a * b * c,
    ], axis=-1)  # fmt: skip
    f1, f2, f3 = np.moveaxis(terms @ _POLYNOMIALS.T, -1, 0)
    whole = np.stack([onward * (f1 * sine + f2 * ahead), -f1 * cosine - f2 * down - f3], axis=-1)
    pressure = np.maximum(-(whole * normal).sum(axis=-1), 0.0)
    shear = whole - (whole * normal).sum(axis=-1, keepdims=True) * normal
    size = np.maximum(np.linalg.norm(shear, axis=-1), 1e-12)
    part = np.minimum(friction * pressure / size, 1.0)
    found = -pressure[..., None] * normal + part[..., None] * shear
    return np.where(leads[..., None], found, 0.0)


def outline(tool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pieces of an upright tool about the position of its pose: places and outward normals [n, 2]
    (along, up; m), lengths [n]."""
    is_wheel = tool.name == 'wheel'
    turn = np.linspace(0, 2 * np.pi, 2 * PIECES + 1) if is_wheel else np.linspace(-np.pi, 0, PIECES)
    middle = (turn[1:] + turn[:-1]) / 2
    round_normal = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    places, lengths = tool.radius * round_normal, tool.radius * np.diff(turn)
    if is_wheel:
        return places, round_normal, lengths
    heights = (np.arange(PIECES) + 0.5) / PIECES * tool.length
    sides = np.repeat([[1.0, 0.0], [-1.0, 0.0]], PIECES, axis=0)
    faces = tool.radius * sides + np.stack([0 * (two := np.tile(heights, 2)), two], axis=1)
    return (
        np.concatenate([places, faces]), np.concatenate([round_normal, sides]),
        np.append(lengths, np.full(2 * PIECES, tool.length / PIECES)),
    )  # fmt: skip


def loads(run) -> tuple[np.ndarray, np.ndarray]:
    """Force [T, 3] along, up, across (N) and torque [T, 3] in the world (N m) of a `runs.Run`. A
    tool that halts feels what it felt last."""
    whole = samples.episode_of(run)
    tool, soil, place = run.tool, run.soil, whole.passage.place
    path = place.local(run.pose[:, :3])[:, :2]
    lean = np.unwrap(place.turns(run.pose)[:, 0])
    at, normal, length = outline(tool)
    cosine, sine = np.cos(lean), np.sin(lean)
    turn = np.moveaxis(np.array([[cosine, -sine], [sine, cosine]]), 2, 0)  # [T, 2, 2]
    arm, normal = at @ turn.transpose(0, 2, 1), normal @ turn.transpose(0, 2, 1)
    step = np.diff(arm + path[:, None], axis=0)
    step = np.concatenate([step[:1], step])
    size = np.linalg.norm(step, axis=-1, keepdims=True)
    moves = (size > 1e-7).any(axis=(1, 2))
    last = np.maximum.accumulate(np.where(moves, np.arange(len(step)), 0))
    motion = (step / np.maximum(size, 1e-12))[last]
    friction = earthmoving.BLADE_FRICTION if tool.name == 'blade' else (
        wheel_terramechanics.RIM_FRICTION
    )  # fmt: skip
    surface = path[:, 1] - tool.radius + evaluation.edge_depth(run, whole.frames)
    depth = np.maximum(surface[:, None] - (arm + path[:, None])[..., 1], 0.0)
    xi = scale(soil.density, soil.gravity, soil.friction)
    of_piece = (xi * tool.width * length * depth)[..., None] * stress(normal, motion, friction)
    force = np.concatenate([of_piece.sum(axis=1), np.zeros((len(path), 1))], axis=1)
    torque = (arm[..., 0] * of_piece[..., 1] - arm[..., 1] * of_piece[..., 0]).sum(axis=1)
    return force, torque[:, None] * place.across


def gain(runs: list) -> float:
    """The factor on the forces of the theory that fits runs best, each of equal weight."""
    sums = np.zeros(2)
    for run in runs:
        force = place_of(run.pose[0]).vectors(loads(run)[0])[H:]
        true = np.asarray(run.force[H:], np.float64)
        sums += np.array([(force * true).sum(), (force**2).sum()]) / (true**2).sum()
    return float(sums[0] / sums[1])


def errors(run, factors: tuple[float, ...] = (1.0,)) -> list[dict[str, float]]:
    """`evaluation.load_errors` of the theory, times each of some factors."""
    force, torque = loads(run)
    world = place_of(run.pose[0]).vectors(force)
    return [evaluation.load_errors(run, f * world[H:], f * torque[H:]) for f in factors]
