"""Draws how tools move, and what the soil did.

    python -m mpm.picture --scene=excavation --cases=22,lift_0003,disturbed_0004 \\
        --output_path=paths.png
    python -m mpm.picture --scene=wheel --operator_seeds=9000-9004 --output_path=new.png
    python -m mpm.picture --scene=excavation --path=mine.csv --output_path=mine.png
    python -m mpm.picture --scene=excavation --raw_path=raw/excavation --output_path=runs.png

Paths: one strip for each run, the tool's outline every half second, light to dark. The grey line is
the lead-in (an earlier pass), the blue one the recorded path of the lowest point.
Runs (`--raw_path`; the first of each kind, or those of --cases): six moments from the side, soil
near the tool's plane, coloured by how far it has moved. Needs matplotlib (`pip install .[viz]`).
"""

import os

import numpy as np
from absl import flags

from mpm import bodies, raw_run, scenes
from mpm.generate import chosen_runs, define_run_flags
from mpm.motions import catalogue
from pca_tools import command

OUTLINE_EVERY = 0.5  # s
POINTS = 40  # of half a circle


def outline(body, pose) -> np.ndarray:
    """Returns the outline of a body seen from the side, closed, float64 [K, 2], m; a polygon
    without the radius of its edges."""
    if body.is_wheel:
        turn = np.linspace(-np.pi / 2, 3 * np.pi / 2, max(2 * POINTS, 8 * body.grousers + 1))
        reach = np.full(len(turn), body.radius)
        if body.grousers:
            pitch = 2 * np.pi / body.grousers
            away = np.abs(np.mod(turn + pitch / 2, pitch) - pitch / 2)
            reach += body.grouser_height * (away < body.grouser_radius / body.radius + pitch / 16)
        ring = reach[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    elif len(body.outline) == 2:
        low, high = body.outline
        along = np.arctan2(*(high - low)[::-1])
        turn = along + np.linspace(np.pi / 2, 3 * np.pi / 2, POINTS)
        arc = body.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ring = np.concatenate([low + arc, high - arc, low + arc[:1]])
    else:
        ring = np.concatenate([body.outline, body.outline[:1]])
    x, y, theta, _ = pose
    turned = [[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]]
    return ring @ np.array(turned) + [x, y]


def draw_motion(axes, scene: scenes.Scene, motion: catalogue.Motion) -> None:
    """Draws one run into matplotlib's `axes`; a free wheel is drawn on the flat surface."""
    box, drive = scene.bin, motion.drive
    times = np.arange(motion.simulated_frames + 1) / scenes.FRAME_RATE
    poses, body = drive.pose(times), drive.body
    rides = drive.machine is not None and body.is_wheel
    if rides:
        poses[:, 1] = box.surface + body.reach
    start = drive.lead_in
    low, right = scenes.CORNER, scenes.CORNER + box.size[0]
    axes.fill_between([low, right], low, box.surface, color='#e8dcc0')
    axes.plot([low, low, right, right], [box.surface + 0.03, low, low, box.surface + 0.03], 'k-')
    tip = poses[:, 1] + bodies.lowest(body, poses[:, 2])
    axes.plot(poses[: start + 1, 0], tip[: start + 1], color='0.6', linewidth=1)
    axes.plot(poses[start:, 0], tip[start:], color='tab:blue', linewidth=1.5)
    every = round(OUTLINE_EVERY * scenes.FRAME_RATE)
    for frame in range(start, len(poses), every):
        shade = 0.75 - 0.65 * (frame - start) / max(1, motion.frames)
        ring = outline(body, poses[frame])
        axes.plot(ring[:, 0], ring[:, 1], color=str(shade), linewidth=0.8)
        if rides:  # the turn of the wheel
            spoke = np.array([poses[frame, :2], ring[0]])
            axes.plot(spoke[:, 0], spoke[:, 1], color=str(shade), linewidth=0.8)
    title = f'{scene.name} {motion.case}, {2 * body.half_width:.3g} m wide'
    axes.set_title(title, fontsize=8, loc='left')
    axes.set_aspect('equal')
    axes.set_xlim(low - 0.02, right + 0.2)
    axes.set_ylim(low - 0.02, box.surface + (0.32 if body.is_wheel else 0.42))
    axes.tick_params(labelsize=6)


def panels(rows: int, columns: int, size: tuple[float, float]):
    """Returns a figure of panels (each of a size in inches) and the array of their axes."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    size = size[0] * columns, size[1] * rows
    return pyplot.subplots(rows, columns, figsize=size, squeeze=False, layout='constrained')


def draw(scene: scenes.Scene, cases, output_path: str, tool: dict | None = None) -> None:
    """Draws all cases, perhaps with another tool, into one picture file; ValueError as
    `catalogue.motion_of`."""
    if not cases:
        raise ValueError('nothing to draw: --cases, --operator_seeds, --path or --raw_path')
    drawn = [catalogue.in_bin(scene, case) for case in cases]
    motions = [catalogue.motion_of(within, case, tool) for within, case in zip(drawn, cases)]
    columns = min(3, len(motions))
    figure, grid = panels(-(-len(motions) // columns), columns, (4.6, 2.6))
    for axes in grid.flat[len(motions) :]:
        axes.set_axis_off()
    for axes, within, motion in zip(grid.flat, drawn, motions):
        draw_motion(axes, within, motion)
    figure.savefig(output_path, dpi=120)


MOMENTS = 6  # of a run
SLICE = 0.04  # m, half the thickness of the soil that is shown
FARTHEST = 100.0  # mm of way, from where the colour does not change


def first_of_each_kind(folder: str) -> list:
    """Returns the ids of the first finished run of each kind in a folder; ValueError: it holds
    none."""
    found: dict[str, int | str] = {}
    for entry in (raw_run.read_manifest(folder) or {'runs': []})['runs']:
        found.setdefault(entry['parameters']['kind'], entry['case'])
    if not found:
        raise ValueError(f'{folder}: no finished raw runs')
    return list(found.values())


def body_of(parameters: dict) -> bodies.Body:
    if 'tool' in parameters:
        return bodies.tool_body(parameters['tool'])
    if 'diameter_m' in parameters:
        return bodies.make_wheel(parameters['diameter_m'])
    return bodies.make_blade(parameters['body_width_m'])


def draw_runs(folder: str, cases, output_path: str) -> None:
    """Draws raw runs of a folder into one picture file, a row each; ValueError: it lacks one."""
    figure, grid = panels(len(cases), MOMENTS, (2.8, 1.9))
    for row, case in zip(grid, map(catalogue.run_id, cases)):
        run = raw_run.read_run(os.path.join(folder, raw_run.file_name(case)))
        body, (length, depth, _) = body_of(run.parameters), run.parameters['bin_m']
        way = 1e3 * np.linalg.norm(run.positions - run.positions[0], axis=2)
        for axes, frame in zip(row, np.linspace(0, len(way) - 1, MOMENTS).astype(int)):
            x, y, z, w, _, _, sine = run.pose[frame]
            near = np.abs(run.positions[frame, :, 2] - z) < SLICE
            shown = axes.scatter(
                *run.positions[frame, near, :2].T, c=way[frame, near], s=1.5, vmin=0, vmax=FARTHEST
            )
            axes.plot(*outline(body, (x, y, 2 * np.arctan2(sine, w), z)).T, 'r-', linewidth=0.8)
            time, (along, upwards, _) = frame / scenes.FRAME_RATE, run.force[frame]
            axes.set_title(f'{time:.1f} s: {along:.0f}, {upwards:.0f} N', fontsize=8)
            axes.set_aspect('equal')
            axes.set_xlim(scenes.CORNER, scenes.CORNER + length)
            axes.set_ylim(scenes.CORNER, scenes.CORNER + depth + max(0.15, depth))
            axes.tick_params(labelsize=6)
        row[0].set_ylabel(str(case), fontsize=9)
    figure.colorbar(shown, ax=grid, label='way since the first frame, mm', shrink=0.6)
    figure.suptitle('Soil from the side; force on the tool along x and upwards', fontsize=11)
    figure.savefig(output_path, dpi=90)


def define_flags() -> None:
    define_run_flags()
    flags.DEFINE_string('raw_path', None, 'Folder of raw runs, of which the soil is drawn.')
    flags.DEFINE_string('output_path', None, 'Picture file.', required=True)


def main(values) -> None:
    scene, cases, tool = chosen_runs(values)
    if values.raw_path is None:
        draw(scene, cases, values.output_path, tool)
    else:
        cases = cases or first_of_each_kind(values.raw_path)
        draw_runs(values.raw_path, cases, values.output_path)
    print(f'wrote {values.output_path}: {len(cases)} runs')


if __name__ == '__main__':
    define_flags()
    command.start(main)
