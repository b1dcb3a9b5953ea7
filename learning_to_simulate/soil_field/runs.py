"""Runs as a soil field learns from them."""

import dataclasses
import os
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import STANDARD_GRAVITY, Blade, Soil, Tool, tool_as
from pca_tools import dataset, heights, particles

# The solver's cells make a round edge half a cell blunter (`mpm.verification.ladder`), m.
BLUNTER = 0.0033


class Machine(NamedTuple):
    """What carries a tool that is free along, up or in its lean; what drove a run of T frames.

    Attributes:
      mass, inertia: kg; kg m2 about the position of the pose.
      free: of x, y and angle, as `loaded.COORDINATES`.
      stiffness, damping: [3] of the actuators, as `loaded.LoadedTool` takes them.
      target: float64 [T, 7] poses that they pull towards; where nothing is free, the path.
      external: float64 [T, 6] force (N) and torque (N m) beside soil and actuators; weight is in.
    """

    mass: float
    inertia: float
    free: tuple[bool, bool, bool]
    stiffness: np.ndarray
    damping: np.ndarray
    target: np.ndarray
    external: np.ndarray


class Run(NamedTuple):
    """One run of a tool on a bed.

    Attributes:
      case, kind, split: names.
      tool, soil: of it.
      pose: float64 [T, 7]; force, torque: [T, 3] on the tool, N, N m.
      heights: [F, nx, nz] m, every `stride` frames; corner, cell: [2] of the map, m.
      particles: [F, P, 3] m, or None.
      dt: s of a frame.
      machine: of a tool that was not moved along a given path; else None.
      floor: of the bed, m; far below where it is not known.
      lead_in: whether an earlier pass had changed the bed.
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
    machine: Machine | None = None
    floor: float = -1e3
    lead_in: bool = False

    def terrain(self, frame: int = 0) -> Terrain:
        """The bed in a frame with heights."""
        return Terrain(
            self.heights[frame // self.stride], self.cell, self.corner, self.soil,
            floor=min(self.floor, float(self.heights.min())), walled=True,
        )  # fmt: skip

    def resized(self, size: float) -> 'Run':
        """The run of a blade and bed so many times as large, without particles and machine: what
        dry soil does there by similarity (`mpm/README.md`), times as the root of lengths, where it
        is as much lighter, so that its grains are as stiff against its weight. Cells grow with the
        rest, so the edge of the copy stands for one of (r + BLUNTER) size - BLUNTER.
        """
        tool: Any = self.tool
        pose = self.pose * np.array([size] * 3 + [1.0] * 4)
        edge = size * (tool.radius + BLUNTER) - BLUNTER
        larger = {'width': size * tool.width, 'radius': edge, 'length': size * tool.length}
        return self._replace(
            tool=dataclasses.replace(tool, **larger), pose=pose, heights=size * self.heights,
            soil=dataclasses.replace(self.soil, density=self.soil.density / size),
            force=size**2 * self.force, torque=size**3 * self.torque, corner=size * self.corner,
            cell=size * self.cell, dt=size**0.5 * self.dt, floor=size * self.floor,
            particles=None, machine=None,
        )  # fmt: skip

    def mirrored(self) -> 'Run':
        """The run of a wheel, which is its own mirror image, with the sign of x changed: it goes
        backwards where the run goes forwards. Without a machine."""
        of_places, of_turns = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0])
        length = self.heights.shape[1] * self.cell[0]
        return self._replace(
            pose=self.pose * np.concatenate([of_places, [1.0], of_turns]),
            force=self.force * of_places, torque=self.torque * of_turns,
            heights=self.heights[:, ::-1],
            corner=np.array([-self.corner[0] - length, self.corner[1]]),
            particles=None if self.particles is None else self.particles * np.float32(of_places),
            machine=None,
        )  # fmt: skip

    def before(self) -> Terrain:
        """The bed before the tool stood on it. A wheel has sunk into it in the first frame, unless
        it has made a rut and is over that."""
        terrain = self.terrain()
        if self.tool.name == 'wheel' and not self.lead_in:
            terrain.write(slice(None), np.median(terrain.heights))
        return terrain


def tool_of(case: dict) -> Tool:
    described = case.get('tool') or {}
    if 'diameter_m' in case:
        wheel = {'radius': float(case['diameter_m']) / 2, 'width': case['body_width_m']}
        return tool_as(described | wheel)
    width = float(case.get('blade_width_m', described.get('width', case['body_width_m'])))
    return tool_as(described | {'width': width}) if described else Blade(width)


def read(folder: str, split: str) -> list[Run]:
    """The runs of a split of a dataset; without particles where it has no sample of them.

    Raises:
      FileNotFoundError: no such split, or a dataset without height maps.
      ValueError: a damaged file, a run without force, torque or pose, a case that says neither
        tool nor soil.
    """
    metadata = dataset.read_metadata(folder)
    maps = heights.read(folder, split)
    has_sample = os.path.exists(particles.sample_path(folder, split))
    sample = particles.read_sample(folder, split) if has_sample else None
    if sample is not None and sample.frame_stride != maps.frame_stride:
        raise ValueError(
            f'{folder}: particles are kept every {sample.frame_stride} frames, heights every '
            f'{maps.frame_stride}: convert its runs again'
        )
    found = []
    cases = metadata.get('cases', {}).get(split, [])
    records = dataset.read_split(folder, split)
    for i, (record, case) in enumerate(zip(records, cases, strict=True)):
        parts = (record.rigid_pose, record.force, record.torque)
        if any(part is None for part in parts):
            raise ValueError(
                f'{folder}: run {case.get("case", i)} lacks a pose, force or torque, from which a '
                f'soil field learns; convert runs that have them'
            )
        try:
            found.append(
                Run(
                    str(case['case']), str(case.get('kind', 'run')), split, tool_of(case),
                    soil_of(case), record.rigid_pose.astype(np.float64), record.force,
                    record.torque, np.asarray(maps[i]), maps.frame_stride,
                    np.asarray(maps.corner), np.asarray(maps.cell),
                    None if sample is None else sample[i], float(metadata['dt']),
                    machine_of(case, record), floor_of(case, maps[i]),
                    bool(case.get('lead_in_frames')),
                )
            )  # fmt: skip
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            raise ValueError(
                f'{folder}: run {case.get("case")} does not say its tool as a soil field needs it '
                f'({error!r}): give `blade_width_m`, or `diameter_m` and `body_width_m`, or `tool`'
            ) from error
    return found


def read_all(folders, split: str, is_needed: bool = True) -> list[Run]:
    """`read` of several folders; where the split is not needed, of those that have it."""
    there = [f for f in folders if is_needed or os.path.exists(dataset.split_path(f, split))]
    return [run for folder in there for run in read(folder, split)]


def floor_of(case: dict, maps) -> float:
    """Floor of the bin of a run, m: its depth below most of the first of maps [F, nx, nz]."""
    return float(np.median(maps[0])) - float(case['bin_m'][1]) if 'bin_m' in case else -1e3


def machine_of(case: dict, record: dataset.Trajectory) -> Machine | None:
    """What carried the tool of a run, from its parameters and its record of target and external
    load; a wheel that says no more is free in height, as heavy as its first load."""
    if record.target is None or record.external is None:
        return None
    target, external = (np.asarray(x, np.float64) for x in (record.target, record.external))
    said = case.get('machine') or {'is_free': (False, True, False)}
    pose, half = record.rigid_pose.astype(np.float64), target[:, 2] / 2  # type: ignore[union-attr]
    pose[:, :2] = target[:, :2]
    zero = 0.0 * half
    pose[:, 3:] = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)
    load = np.zeros((len(pose), 6))
    load[:, [0, 1, 5]] = external
    springs, dampers = (np.array(said.get(n, [0.0] * 3), float) for n in ('stiffness', 'damping'))
    return Machine(
        float(said.get('mass_kg', -external[0, 1] / STANDARD_GRAVITY)),
        float(said.get('inertia_kg_m2', 0.0)),
        tuple(map(bool, said['is_free'])), springs, dampers, pose, load,
    )  # fmt: skip


def soil_of(case: dict) -> Soil:
    """The soil of a run, from its parameters or the usual one."""
    names = 'friction_angle_deg', 'bulk_density_kg_m3', 'gravity_m_s2'
    of_soil = zip(('friction_angle_deg', 'density', 'gravity'), names, strict=True)
    return Soil(**{own: float(case[name]) for own, name in of_soil if name in case})
