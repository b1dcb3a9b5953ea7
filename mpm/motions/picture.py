"""Draws how tools move: one strip for each run, the tool's outline every half second.

    python -m mpm.motions.picture --scene=excavation --cases=22,lift_0003,disturbed_0004 \\
        --output_path=paths.png
    python -m mpm.motions.picture --scene=wheel --operator_seeds=9000-9004 --output_path=new.png
    python -m mpm.motions.picture --scene=excavation --path=mine.csv --output_path=mine.png

The grey line is the lead-in (an earlier pass), the blue one the recorded path of the lowest point;
outlines go from light to dark in time. Needs matplotlib (`pip install .[viz]`).
"""

import sys

import numpy as np
from absl import app, flags

from mpm import bodies, scenes
from mpm.motions import catalogue
from mpm.motions.recording import Recording
from pca_tools.storage import messages

OUTLINE_EVERY = 0.5  # s


def outline(body, pose, count: int = 40) -> np.ndarray:
    """Returns the outline of a body seen from the side, closed, float64 [K, 2], m.

    A polygon is drawn without the radius of its edges.
    """
    if body.is_wheel:
        ring = _rim(body, count)
    elif len(body.outline) == 2:
        low, high = body.outline
        along = np.arctan2(*(high - low)[::-1])
        turn = along + np.linspace(np.pi / 2, 3 * np.pi / 2, count)
        arc = body.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ring = np.concatenate([low + arc, high - arc, low + arc[:1]])
    else:
        ring = np.concatenate([body.outline, body.outline[:1]])
    x, y, theta, _ = pose
    turned = [[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]]
    return ring @ np.array(turned) + [x, y]


def _rim(body, count):
    """The rim of a wheel with its grousers, from below on."""
    turn = np.linspace(-np.pi / 2, 3 * np.pi / 2, max(2 * count, 8 * body.grousers + 1))
    reach = np.full(len(turn), body.radius)
    if body.grousers:
        pitch = 2 * np.pi / body.grousers
        away = np.abs(np.mod(turn + pitch / 2, pitch) - pitch / 2)
        reach += body.grouser_height * (away < body.grouser_radius / body.radius + pitch / 16)
    return reach[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def draw_motion(axes, scene: scenes.Scene, motion: catalogue.Motion) -> None:
    """Draws one run into matplotlib's `axes`; a free wheel is drawn on the flat surface."""
    box, drive = scene.bin, motion.drive
    times = np.arange(motion.simulated_frames + 1) / scenes.FRAME_RATE
    poses = drive.pose(times)
    body = drive.body
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
    width = 2 * body.half_width
    axes.set_title(f'{scene.name} {motion.case}, {width:.3g} m wide', fontsize=8, loc='left')
    axes.set_aspect('equal')
    axes.set_xlim(low - 0.02, right + 0.2)
    axes.set_ylim(low - 0.02, box.surface + (0.32 if body.is_wheel else 0.42))
    axes.tick_params(labelsize=6)


def draw(scene: scenes.Scene, cases, output_path: str, tool: dict | None = None) -> None:
    """Draws all cases, perhaps with another tool, into one picture file.

    Raises:
        ValueError: see `catalogue.motion_of`.
    """
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    drawn = [catalogue.in_bin(scene, catalogue.bin_name(scene, case)) for case in cases]
    motions = [catalogue.motion_of(within, case, tool) for within, case in zip(drawn, cases)]
    columns = min(3, len(motions))
    rows = -(-len(motions) // columns)
    figure, grid = pyplot.subplots(
        rows, columns, figsize=(4.6 * columns, 2.6 * rows), squeeze=False, layout='constrained'
    )
    for axes in grid.flat[len(motions) :]:
        axes.set_axis_off()
    for axes, within, motion in zip(grid.flat, drawn, motions):
        draw_motion(axes, within, motion)
    figure.savefig(output_path, dpi=120)
    pyplot.close(figure)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_enum('scene', None, sorted(scenes.SCENES), 'Which scene.', required=True)
    flags.DEFINE_list('cases', [], 'Numbers of cases and ids of seeds: 22,lift_0003.')
    flags.DEFINE_string('operator_seeds', None, 'Seeds whose kinds take turns: 9000-9009.')
    flags.DEFINE_string('kinds', None, 'Kinds that take turns among these seeds.')
    flags.DEFINE_string('tool', None, 'JSON file of a tool (mpm/bodies.py).')
    flags.DEFINE_list('path', [], 'CSV files of paths.')
    flags.DEFINE_string('output_path', None, 'Picture file.', required=True)


def main(argv) -> None:
    """Runs the command."""
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    values = flags.FLAGS
    scene = scenes.scene_named(values.scene)
    try:
        cases = [int(case) if case.isdecimal() else case for case in values.cases]
        if values.operator_seeds is not None:
            cases += catalogue.select_seeds(scene, values.operator_seeds, values.kinds)
        cases += [Recording(path, scenes.WHEEL.demo_case) for path in values.path]
        if not cases:
            raise ValueError('nothing to draw: give --cases, --operator_seeds or --path')
        tool = None if values.tool is None else bodies.read_tool(values.tool)
        draw(scene, cases, values.output_path, tool)
    except (ValueError, OSError, ImportError) as error:
        sys.exit(f'error: {messages.printable(error)}')
    print(f'wrote {values.output_path}: {len(cases)} runs')


if __name__ == '__main__':
    define_flags()
    app.run(main)
