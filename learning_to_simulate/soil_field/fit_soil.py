"""Finds friction angle and density of a soil from a few recorded digs.

Examples:
  lts fit-soil digs.csv --tool=width=0.4 --output_path=soil.json --picture=soil.png

  # a wheel, on ground that `lts.Terrain.save` wrote, of a soil that was weighed
  lts fit-soil rolls.csv --model=wheel --tool=radius=0.15 --tool=width=0.1 --terrain=ground.npz \
      --density=1600 --output_path=soil.json

  # recorded runs of a dataset, each on its own bed
  lts fit-soil datasets/excavation --cases=soils_0007,soils_0019 --output_path=soil.json

`soil_field/digs.py` says which columns a CSV file has. With the force F_rt that was measured in
frame t of run r and that of the model, s G_rt(angle), where s is the density over the standard one,

  S(angle, s) = sum over r of sum_t |F_rt - s G_rt(angle)|^2 / sum_t |F_rt|^2               (1)

is least at the soil that is found: each run counts alike. On a given path the density is a factor
of the force, so s follows from the angle in closed form; how stiff grains are against their weight
stays as at the standard density, since fits of validation runs scatter more with that of each s.

The spread is the largest of three: that of the curvature of S, for as many independent frames as
the residuals have (Geyer 1992, doi:10.1214/ss/1177011137, their first positive sequence); that of
leaving out one run after the other (Efron & Stein 1981, doi:10.1214/aos/1176345462); and what the
model is off by itself.
"""

import dataclasses
import math
import os
from collections.abc import Sequence

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import command, shipped
from learning_to_simulate.rollout_status import RolloutStatus
from pca_tools import files

LEAST_FRAMES = 30  # in the soil
# By how much the blade's field is off (root mean square) in one valid dig of a known soil, by
# `python -m reports soil_fits`: deg and a share of the density; deg where the density is given.
OFF, OFF_GIVEN = (1.13, 0.133), 0.7
FLAGGED, MISFIT = 0.5, 0.6  # shares of frames and of the force from which on nothing is told
DENSITIES = (500.0, 4000.0)  # kg/m3, of any soil
NODE, FINE = 1.0, 0.01  # deg between angles that are rolled out, and that are looked at
FRAME = 1.0 / 60.0  # s, the longest step of a rollout
AT_END = 0.25  # deg


@dataclasses.dataclass(frozen=True)
class Fit:
    """A soil that meets digs best.

    Attributes:
      angle_deg, density: of the best fit, kg/m3; None where the data cannot tell.
      angle_spread_deg, density_spread: one standard deviation.
      reasons: why the data cannot tell; empty where they can.
      correlation: of angle and density; 0 of a given density.
      trade_percent: by how much the density falls where the angle grows by 1 deg on the same force.
      known_spread_deg: the angle's spread by curvature if the density were known.
      misfit: root of S over the number of runs.
      profile: angle (deg), misfit and density of all angles that were looked at, lists.
      left_out: name of a run -> angle and density without it.
      runs: of each run its name, frames in the soil, share of flagged ones, misfit.
      curves: of each run [T], s, and measured and fitted force [T, 3], N; for the picture.
    """

    angle_deg: float | None = None
    density: float | None = None
    angle_spread_deg: float | None = None
    density_spread: float | None = None
    reasons: tuple[str, ...] = ()
    correlation: float = 0.0
    trade_percent: float = 0.0
    known_spread_deg: float | None = None
    misfit: float | None = None
    profile: dict = dataclasses.field(default_factory=dict)
    left_out: dict = dataclasses.field(default_factory=dict)
    runs: tuple[dict, ...] = ()
    curves: Sequence = ()

    def __str__(self) -> str:
        lines = []
        if self.reasons:
            lines += ['these data cannot tell the soil:', *(f'  {why}' for why in self.reasons)]
        else:
            spread = '' if self.density_spread is None else f' +- {self.density_spread:.0f}'
            lines.append(
                f'friction angle {self.angle_deg:.1f} +- {self.angle_spread_deg:.1f} deg, '
                f'density {self.density:.0f}{spread or " (given)"} kg/m3'
            )
            if spread:
                lines.append(
                    f'  1 deg more is as {self.trade_percent:.0f} % less density (correlation '
                    f'{self.correlation:.2f}); a known density (--density) would leave '
                    f'{self.known_spread_deg:.2f} deg of the spread by curvature'
                )
            lines += [
                f'  without {name}: {angle:.1f} deg, {density:.0f} kg/m3'
                for name, (angle, density) in self.left_out.items()
            ]
        lines += [
            f'  {run["name"]}: {run["frames"]} frames in the soil'
            + (f', force off by {100 * run["misfit"]:.0f} %' if run['misfit'] is not None else '')
            + (f', {100 * run["flagged"]:.0f} % flagged: {run["why"]}' if run['flagged'] else '')
            for run in self.runs
        ]
        return '\n'.join(lines)

    def to_json(self) -> dict:
        return {
            f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != 'curves'
        }


class Rolled:
    """A dig as a field sees it at K angles; `progress` wraps these.

    Attributes:
      angles: float64 [K], deg, evenly spaced over all that the field was taught.
      forces: [K, T, 3] N, at the standard density; judged: of each angle T judgements.
      force, counted: [T, 3] measured force, 0 where there is none; where there is one.
      size: root of the sum of squares of the measured force.
      in_soil: frames with a measured force in which the tool feels soil.

    Raises:
      ValueError: a tool of another kind; a path that the field refuses.
    """

    def __init__(self, field, dig, progress=iter):
        low, high = np.degrees(np.arctan(field.ranges['friction']))
        self.angles = np.linspace(low, high, max(math.ceil((high - low) / NODE), 2) + 1)
        rollouts = [_rolled_out(field, dig, float(angle)) for angle in progress(self.angles)]
        self.forces = np.stack([force for force, _ in rollouts])
        self.judged = [judged for _, judged in rollouts]
        self.meet(dig)

    def meet(self, dig) -> None:
        """Holds the forces against those of a dig of the same path."""
        self.dig, self.counted = dig, ~np.isnan(dig.force)
        self.force = np.where(self.counted, dig.force, 0.0)
        self.size = math.sqrt(np.square(self.force).sum())
        felt = np.linalg.norm(self.forces, axis=2).min(axis=0) > 0
        self.in_soil = int((felt & self.counted.any(axis=1)).sum())
        if self.size:
            flat = (self.forces * self.counted).reshape(len(self.angles), -1) / self.size
            # Products of the forces at two angles, and with the measured one, which has size 1.
            self.gram, self.with_force = flat @ flat.T, flat @ self.force.ravel() / self.size

    def at(self, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Force [T, 3] at an angle, N, and its slope, N/deg."""
        k = min(int(np.searchsorted(self.angles, angle, side='right')) - 1, len(self.angles) - 2)
        slope = (self.forces[k + 1] - self.forces[k]) / (self.angles[k + 1] - self.angles[k])
        return self.forces[k] + (angle - self.angles[k]) * slope, slope

    def flagged(self, angle: float) -> tuple[float, str]:
        """The share of frames in the soil that are outside of training, and why the first is."""
        k = int(np.argmin(np.abs(self.angles - angle)))
        seen = [j for j, f in zip(self.judged[k], self.forces[k], strict=True) if f.any()]
        bad = [j.reason for j in seen if j.status != RolloutStatus.OK]
        return len(bad) / max(len(seen), 1), bad[0] if bad else ''


def _rolled_out(field, dig, angle):
    """Force [T, 3] at an angle and the standard density, N, and the judgement of each row."""
    from learning_to_simulate.soil_field.stepper import SoilStepper
    from learning_to_simulate.soil_field.tools import Soil

    terrain = dig.terrain.clone(Soil(angle, gravity=dig.terrain.soil.gravity))
    try:
        stepper = SoilStepper(field, terrain, dig.tool)
        frame = stepper.start(dig.pose[0])
        forces, judged = [frame.force], [frame.now]
        for before, pose, dt in zip(dig.pose, dig.pose[1:], np.diff(dig.times), strict=False):
            parts = math.ceil(dt / FRAME - 1e-3)
            step = pose - before
            if pose[3:] @ before[3:] < 0:  # the same turn by the shorter way
                step[3:] = -pose[3:] - before[3:]
            frames = [
                stepper.step(before + step * (k + 1) / parts, dt / parts) for k in range(parts)
            ]
            forces.append(np.mean([frame.force for frame in frames], axis=0))
            judged.append(frames[-1].now)
    except ValueError as error:
        raise ValueError(f'run {dig.name}: {error}') from error
    return np.array(forces), judged


def fit(rolled: Sequence[Rolled], density: float | None = None) -> Fit:
    """The soil for which a field meets digs in it best; of a density, kg/m3, where it is known.

    Raises:
      ValueError: no digs, a density of no soil.
    """
    from learning_to_simulate.soil_field.tools import STANDARD_DENSITY

    if not rolled:
        raise ValueError('no digs to fit a soil to')
    if density is not None and not DENSITIES[0] <= density <= DENSITIES[1]:
        raise ValueError(f'density is {density} kg/m3, must lie in {DENSITIES}')
    nodes = rolled[0].angles
    low, high = nodes[[0, -1]]
    fine = np.arange(low, high, FINE)
    runs = [{'name': r.dig.name, 'frames': r.in_soil, 'flagged': 0.0, 'why': '', 'misfit': None}
            for r in rolled]  # fmt: skip
    used = [r for r in rolled if r.in_soil and r.size > 0]
    if sum(r.in_soil for r in used) < LEAST_FRAMES:
        digs = [r.dig for r in rolled]
        lowest = min(float((d.pose[:, 1] - d.tool.radius).min()) for d in digs)
        top = max(float(d.terrain.heights.max()) for d in digs)
        why = (
            f'{sum(r.in_soil for r in used)} frames with a force in the soil, at least '
            f'{LEAST_FRAMES} are needed (the tool reaches down to y = {lowest:.3f} m, the ground '
            f'up to {top:.3f} m)'
        )
        return Fit(reasons=(why,), runs=tuple(runs))
    given = None if density is None else density / STANDARD_DENSITY

    def least(of):
        """Angle, s and S of the least, and S and s at all fine angles."""
        k = np.minimum(np.searchsorted(nodes, fine, side='right') - 1, len(nodes) - 2)
        w = (fine - nodes[k]) / (nodes[k + 1] - nodes[k])
        gram, product = sum(r.gram for r in of), sum(r.with_force for r in of)
        b = (1 - w) * product[k] + w * product[k + 1]
        c = (1 - w) ** 2 * gram[k, k] + w**2 * gram[k + 1, k + 1] + 2 * w * (1 - w) * gram[k, k + 1]
        s = b / c if given is None else np.full(len(fine), given)
        total = np.maximum(len(of) - 2 * s * b + s**2 * c, 0.0)
        i = int(np.argmin(total))
        return fine[i], float(s[i]), float(total[i]), total, s

    angle, scale, total, totals, scales = least(used)
    if scale <= 0:
        why = (
            'the measured force pushes the tool on where soil resists, or is nothing: the force of '
            'the soil on the tool was expected, N (docs/axes.md)'
        )
        return Fit(reasons=(why,), runs=tuple(runs))
    # Normal matrix of (angle, s), how many frames are independent, what is flagged.
    normal, independent, curves = np.zeros((2, 2)), 0.0, []
    for r in used:
        force, slope = r.at(angle)
        jacobian = np.stack([scale * slope[r.counted], force[r.counted]]) / r.size
        normal += jacobian @ jacobian.T
        residual = np.where(r.counted, r.force - scale * force, 0.0)
        independent += sum(_independent(residual[r.counted[:, axis], axis]) for axis in range(3))
        row = runs[rolled.index(r)]
        row['misfit'] = math.sqrt(np.square(residual).sum()) / r.size
        row['flagged'], row['why'] = r.flagged(angle)
        curves.append((r.dig.name, r.dig.times, r.dig.force, scale * force))
    free = 1 if given is not None else 2
    chi = max(independent - free, 1.0) / max(total, 1e-12)
    sure = 1 / math.sqrt(chi * normal[0, 0])
    covariance = np.linalg.pinv(chi * normal)
    spreads = [sure, 0.0] if given is not None else np.sqrt(np.diag(covariance)).tolist()
    left_out = {}
    if len(used) > 1:
        left = [least([other for other in used if other is not r])[:2] for r in used]
        left_out = {r.dig.name: (round(float(a), 2), s * STANDARD_DENSITY)
                    for r, (a, s) in zip(used, left, strict=True)}  # fmt: skip
        n = len(left)
        jack = np.sqrt((n - 1) / n * np.square(np.array(left) - np.mean(left, axis=0)).sum(axis=0))
        spreads = np.maximum(spreads, jack).tolist()
    misfit = math.sqrt(total / len(used))
    likely = fine[chi * (totals - total) <= 4.0]
    likely = min(likely[0], angle - 2 * spreads[0]), max(likely[-1], angle + 2 * spreads[0])
    off = (OFF_GIVEN, 0.0) if given is not None else OFF
    spreads = np.maximum(spreads, np.array(off) * [1.0, scale] / math.sqrt(len(used)))
    found = Fit(
        round(float(angle), 2), scale * STANDARD_DENSITY, float(spreads[0]),
        None if given is not None else float(spreads[1]) * STANDARD_DENSITY,
        correlation=float(covariance[0, 1] / math.sqrt(covariance[0, 0] * covariance[1, 1]))
        if given is None else 0.0,
        trade_percent=float(100 * normal[0, 1] / normal[1, 1] / scale),
        known_spread_deg=sure, misfit=misfit,
        profile={
            'angle_deg': fine[::10].tolist(),
            'misfit': np.sqrt(totals / len(used))[::10].tolist(),
            'density': (scales * STANDARD_DENSITY)[::10].tolist(),
        },
        left_out=left_out, runs=tuple(runs), curves=curves,
    )  # fmt: skip
    return _told(found, low, high, likely)


def _told(found: Fit, low, high, likely) -> Fit:
    angle, least, most = found.angle_deg, max(likely[0], low), min(likely[1], high)
    taught = f'the model was taught {low:.1f} to {high:.1f} deg'
    reasons = []
    if found.misfit > MISFIT:
        reasons.append(
            f'no soil of the model comes nearer to these forces than {100 * found.misfit:.0f} %: '
            f'look at tool, surface, axes and units'
        )
    if not DENSITIES[0] <= found.density <= DENSITIES[1]:
        reasons.append(
            f'the density would be {found.density:.4g} kg/m3: is the force in N, and the tool as '
            f'wide as that?'
        )
    if angle - low < AT_END or high - angle < AT_END:
        side = 'least' if angle - low < AT_END else 'largest'
        reasons.append(f'the {side} angle fits best, {angle:.1f} deg, and {taught}')
    elif most - least > (high - low) / 2:
        reasons.append(
            f'angles from {least:.1f} to {most:.1f} deg fit alike, and {taught}: dig deeper or '
            f'farther, more often, or give the --density'
        )
    flagged = [run for run in found.runs if run['misfit'] is not None and run['flagged'] > FLAGGED]
    if flagged:
        names = ', '.join(run['name'] for run in flagged)
        reasons.append(f'outside of what the model was taught: {names} ({flagged[0]["why"]})')
    if not reasons:
        return found
    nothing = dict.fromkeys(('angle_deg', 'density', 'angle_spread_deg', 'density_spread'))
    return dataclasses.replace(found, reasons=tuple(reasons), **nothing)


def _independent(series) -> float:
    """How many independent values a series [T] is worth."""
    off, n = series - series.mean() if len(series) else series, len(series)
    if not np.any(off):
        return float(n > 0)
    spectrum = np.abs(np.fft.rfft(off, 2 * n)) ** 2
    correlation = np.fft.irfft(spectrum)[:n] / (off @ off)
    pairs = correlation[: n - n % 2].reshape(-1, 2).sum(axis=1)
    end = np.flatnonzero(pairs <= 0)
    return n / max(2 * pairs[: end[0] if len(end) else None].sum() - 1, 1.0)


def draw(found: Fit, path: str) -> None:
    """Draws the profile over the angle, and measured and fitted forces of the runs."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from learning_to_simulate.rendering.rollout_figures import INK, STYLE

    count = len(found.curves)
    with rc_context(STYLE):
        figure = Figure((8.0, 2.6 + 1.7 * count), layout='constrained')
        axes = figure.subplots(count + 1, 1, squeeze=False)[:, 0]
        first, other = axes[0], axes[0].twinx()
        first.plot(found.profile['angle_deg'], found.profile['misfit'], color=INK)
        first.set(xlabel='friction angle (deg)', ylabel='misfit of the force', ylim=(0, None))
        other.plot(found.profile['angle_deg'], found.profile['density'], '--', color='#0072b2')
        other.set_ylabel('density (kg/m3)', color='#0072b2')
        other.spines['right'].set_visible(True)
        if found.angle_deg is not None:
            wide = found.angle_spread_deg
            first.axvspan(found.angle_deg - wide, found.angle_deg + wide, color='#e4e7eb')
            first.axvline(found.angle_deg, color='#d55e00')
        first.set_title(str(found).split('\n')[0])
        for row, (title, times, measured, fitted) in zip(axes[1:], found.curves, strict=True):
            for axis, color in enumerate(('#0072b2', '#d55e00', '#009e73')):
                if np.isfinite(measured[:, axis]).any():
                    name = f'measured, {"xyz"[axis]}'
                    row.plot(times, measured[:, axis], color=color, lw=1, label=name)
                    row.plot(times, fitted[:, axis], '--', color=color, lw=1.2, label='fitted')
            row.set(title=title, xlabel='s', ylabel='force (N)')
        axes[1].legend(ncols=2, loc='upper left')
        figure.savefig(path, dpi=120)


def run(values, arguments) -> None:
    if len(arguments) != 1:
        raise ValueError('one CSV file, or one dataset with --cases, was expected')
    source = arguments[0]
    for target in filter(None, (values.output_path, values.picture)):
        command.writable_folder(os.path.dirname(os.path.abspath(target)))
    if values.picture and not values.picture.endswith('.png'):
        raise ValueError(f'{values.picture}: a picture ends in .png')
    model = shipped.find(values.model, 'models')
    if not os.path.exists(source.split(',')[0]):
        raise FileNotFoundError(f'{source}: no such file or dataset')
    command.import_tensorflow()
    from learning_to_simulate.soil_field import digs, method
    from learning_to_simulate.soil_field.terrain import Terrain

    field = method.load(model)
    kind = field.networks.tool
    if source.endswith('.csv'):
        types = {f.name: f.type for f in dataclasses.fields(kind)}
        tool = kind(**command.settings(values.tool, types, 'tool'))
        if values.cases:
            raise ValueError('--cases chooses runs of a dataset; all runs of a CSV file are taken')
        ground = None
        if values.terrain:
            if values['surface'].present or values['gravity'].present:
                raise ValueError('--terrain says its heights and gravity: no --surface, --gravity')
            ground = Terrain.load(values.terrain)
        found = digs.read(source, tool, ground, values.surface, values.gravity)
    else:
        given = [n for n in ('tool', 'terrain', 'surface', 'gravity') if values[n].present]
        if given:
            raise ValueError(f'runs of a dataset say their own --{given[0]}')
        found = digs.of_dataset(source, values.cases)
    with tqdm.tqdm(total=len(found), unit='run', disable=None) as bar:

        def progress(angles):
            yield from angles
            bar.update()

        rolled = [Rolled(field, dig, progress) for dig in found]
    best = fit(rolled, values.density)
    print(best)
    files.write_json(values.output_path, best.to_json() | {'model': values.model, 'data': source})
    print(f'wrote {values.output_path}')
    if values.picture and best.curves:
        draw(best, values.picture)
        print(f'wrote {values.picture}')


if __name__ == '__main__':
    flags.DEFINE_string('model', 'excavation', 'Soil field: folder, or a shipped one by name.')
    flags.DEFINE_list('cases', [], 'Runs of a dataset, by their cases.')
    flags.DEFINE_multi_string('tool', [], 'NAME=VALUE of the tool, as width=0.4; may come again.')
    flags.DEFINE_string('terrain', None, 'Ground before each run: file of `lts.Terrain.save`.')
    flags.DEFINE_float('surface', 0.0, 'Height y of flat ground, m.')
    flags.DEFINE_float('gravity', 9.81, 'm/s2.')
    flags.DEFINE_float('density', None, 'kg/m3, where it is known.')
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_string('picture', None, 'Picture to draw as well, .png.')
    command.start(run, n_argument=1)
