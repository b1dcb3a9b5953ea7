"""Runs as a soil field learns from them."""

import json
from typing import NamedTuple

import numpy as np

from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade, Soil, Tool, Wheel


class Run(NamedTuple):
    """One run of a tool on a bed.

    Attributes:
      case, kind, split: names.
      tool, soil: of it.
      pose: float64 [T, 7]; force, torque: [T, 3] on the tool, N, N m.
      heights: [F, nx, nz] m, every `stride` frames; corner, cell: [2] of the map, m.
      particles: [F, P, 3] m, or None.
    """

    case: str
    kind: str
    split: str
    tool: Tool
    soil: Soil
    pose: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    heights: np.ndarray
    stride: int
    corner: np.ndarray
    cell: np.ndarray
    particles: np.ndarray | None
    dt: float = 1.0 / 60.0

    def terrain(self, frame: int = 0) -> Terrain:
        """The bed in a frame with heights."""
        return Terrain(
            self.heights[frame // self.stride], self.cell, self.corner, self.soil, floor=-1e3,
            walled=True,
        )  # fmt: skip

    def before(self) -> Terrain:
        """The bed before the tool stood on it; a wheel has sunk into it in the first frame."""
        terrain = self.terrain()
        if self.tool.name == 'wheel':
            terrain.write(slice(None), np.median(terrain.heights))
        return terrain


def tool_of(case: dict) -> Tool:
    """The tool of a run, from its parameters."""
    outline = case.get('tool') or {}
    if 'diameter_m' in case:
        lugs = outline.get('grousers') or {}
        return Wheel(
            float(case['body_width_m']), float(case['diameter_m']) / 2,
            int(lugs.get('count', 0)), float(lugs.get('height', 0.0)),
        )  # fmt: skip
    width = float(case.get('blade_width_m', outline.get('width', case['body_width_m'])))
    if not outline:
        return Blade(width)
    top = max(y for _, y in outline['outline']) - min(y for _, y in outline['outline'])
    return Blade(
        width, float(outline['edge_radius']), top, float(outline.get('name') == 'bucket'),
        float('side_plates' in outline),
    )  # fmt: skip


def read_raw(path: str, stride: int = 4, particles: int = 600) -> Run:
    """A raw run of the solver."""
    found = np.load(path)
    case = json.loads(str(found['parameters']))
    size = np.array(case['bin_m'])
    heights = found['heights'][::stride].astype(np.float64)
    pick = np.random.default_rng(0).permutation(found['positions'].shape[1])[:particles]
    return Run(
        str(case['case']), case['kind'], case['split'], tool_of(case),
        Soil(case['friction_angle_deg'], case['bulk_density_kg_m3'], case['gravity_m_s2']),
        found['pose'].astype(np.float64), found['force'], found['torque'], heights, stride,
        np.full(2, 0.1), size[[0, 2]] / heights.shape[1:],
        found['positions'][::stride, np.sort(pick)].astype(np.float64),
    )  # fmt: skip
