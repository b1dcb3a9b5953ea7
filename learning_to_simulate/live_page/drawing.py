"""Shapes, colours and texts of the page, from arrays."""

import html

import numpy as np
from scipy.spatial import ConvexHull

THICKNESS = 0.01  # of a flat body, m
# Colours of the soil from unmoved to moved far, and of heights from low to high.
SOIL = np.array([[70, 42, 20], [140, 82, 26], [210, 132, 24], [235, 72, 18]], float)
HEIGHT = np.array([[38, 50, 96], [58, 120, 138], [140, 180, 110], [245, 225, 130]], float)
MOVED = 0.08  # m, of the last colour of the soil
HEIGHTS = -0.08, 0.05  # m from the bed at rest, of the first and last colour of heights
EMPTY = 90  # grey of a cell without particles
# Colour and words of the lamp.
LAMPS = {
    'ok': ('#2e9e4f', 'within the training runs'),
    'limited': ('#2f7fd0', 'held to the training runs'),
    'outside': ('#e39a1f', 'outside of the training runs'),
    'stopped': ('#cf3b36', 'stopped'),
}


def blended(colours, share) -> np.ndarray:
    """uint8 [..., 3] between colours [K, 3], at shares [...] of the way from 0 to 1."""
    places = np.linspace(0.0, 1.0, len(colours))
    channels = [np.interp(np.nan_to_num(share), places, channel) for channel in colours.T]
    return np.stack(channels, axis=-1).astype(np.uint8)


def shades(count: int) -> np.ndarray:
    """float [N, 1]: brightness of each particle, so that it can be followed by eye."""
    return np.random.default_rng(0).uniform(0.75, 1.05, (count, 1))


def soil_colours(particles, rest, shade) -> np.ndarray:
    """uint8 [N, 3]: how far particles [N, 3] are from where they were, m, times `shades`."""
    share = np.linalg.norm(particles - rest, axis=1) / MOVED
    return (blended(SOIL, share) * shade).astype(np.uint8)


def height_picture(heights, forwards: float, pixels: int = 12):
    """uint8 picture [.., .., 3] of heights [nx, nz], m from the bed at rest, NaN where there are
    none; the drive, down the first axis where `forwards` is -1, goes from left to right."""
    low, high = HEIGHTS
    picture = blended(HEIGHT, (heights - low) / (high - low))
    picture[np.isnan(heights)] = EMPTY
    picture = picture[:: 1 if forwards > 0 else -1].swapaxes(0, 1)
    return picture.repeat(pixels, axis=0).repeat(pixels, axis=1)


def hull(body) -> tuple[np.ndarray, np.ndarray]:
    """Corners float32 [P, 3] and triangles int32 [F, 3] of a closed mesh around a body [R, 3], m; a
    flat one is thickened."""
    extent = np.ptp(body, axis=0)
    thin = np.eye(3)[extent.argmin()] * (THICKNESS / 2 if extent.min() < THICKNESS else 0.0)
    points = np.concatenate([body - thin, body + thin])
    shape = ConvexHull(points)
    centre, triangles = points.mean(axis=0), shape.simplices.copy()
    # The hull's corners come in either order: outward is away from the centre.
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = ((corners[:, 0] - centre) * normal).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return points.astype(np.float32), triangles.astype(np.int32)


def _legend(name, colours, low, high):
    """HTML of a scale of colours [K, 3] from low to high, m."""
    stops = ', '.join(f'rgb({r:g} {g:g} {b:g})' for r, g, b in colours)
    bar = f'<span style="flex:1;background:linear-gradient(to right, {stops})"></span>'
    return (
        f'<div style="padding:2px 12px;font-size:12px">{name}, mm<div style="display:flex;gap:6px">'
        f'{1e3 * low:.0f}{bar}{1e3 * high:.0f}</div></div>'
    )


LEGENDS = _legend('height from the bed at rest', HEIGHT, *HEIGHTS)
LEGENDS += _legend('way that soil has moved', SOIL, 0.0, MOVED)


def lamp(session, rate: float) -> str:
    """HTML of status, loads and, of a wheel, sinkage of a session; the colour is said in words."""
    moment, up = session.moment, session.scene.up_axis
    colour, text = LAMPS[moment.lamp]
    values = [f'{rate:.0f} frames/s']
    if moment.force is not None:
        along = session.forwards * moment.force[0]
        bound = '' if moment.bound is None else f' &plusmn; {moment.bound:.0f}'
        values.append(f'force {along:.0f} along, {moment.force[up]:.0f} up{bound} N')
    if moment.torque is not None:
        values.append(f'torque {moment.torque[3 - up if up else 2]:.2f} N m')
    if session.sinkage is not None:
        values.append(f'sinkage {1e3 * session.sinkage:.1f} mm')
    return (
        f'<div role="status" style="padding:4px 12px;font-size:13px;line-height:1.35">'
        f'<span style="display:inline-block;width:12px;height:12px;border-radius:6px;'
        f'background:{colour}"></span> <b>{text}</b><br>{" &middot; ".join(values)}'
        f'<br><span>{html.escape(moment.reason) or "&nbsp;"}</span></div>'
    )
