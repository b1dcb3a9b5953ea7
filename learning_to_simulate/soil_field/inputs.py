"""Inputs of the networks of a soil field, as tables (`tool.inputs`).

Three networks see a tool's sweep: that of the load, for each strip under the tool and each of its
two neighbours; that of the surface, for places seen from above; that of the soil, for particles.
Heights count from the tool or from the terrain at a place, never from a level: a scene may lie
anywhere.
"""

from typing import NamedTuple

from learning_to_simulate.soil_field import sweep
from learning_to_simulate.tool.inputs import Row, Table

# Offsets along the way at which the bins are seen, m of the field: about a place, and about the
# tool.
AROUND = (-0.2, -0.13, -0.085, -0.055, -0.035, -0.017, 0.0, 0.017, 0.035, 0.055, 0.085, 0.13,
          0.2)  # fmt: skip
SINCE_AROUND = (-0.1, -0.04, 0.0, 0.04, 0.1)
AT_TOOL = (-0.16, -0.1, -0.06, -0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.16)
# The last passage fades over so much travel, m.
RECENT = 0.15

_AREA = (
    Row('area', 0.01), Row('sqrt(relu(area) + 1e-6)', 0.1),
    Row('carried', 0.03, 'tanh'), Row('carried', 0.1, 'tanh'),
)  # fmt: skip
_GAP = 'height - radius - at.surface + at.cut'  # between the tool and what it has cut
_MEMORY = tuple(Row(name) for name in sweep.SCALARS if name[-2:] in ('_0', '_1', '_2', '_3'))
_AHEAD = Row('ahead', 0.1, 'tanh')
_BLADE = (
    Row('lean'), Row('half_width', 0.2), Row('friction', 0.15, shift=0.76),
    Row('radius', 0.01, shift=0.014), Row('length', 0.1, shift=0.277), Row('bucket'),
    Row('plates'),
)  # fmt: skip
_WHEEL = (
    Row('half_width', 0.05, shift=0.06), Row('friction', 0.15, shift=0.76), Row('lugs', 16.0),
    Row('lug_height', 0.01),
)  # fmt: skip
_LOAD = (
    *_AREA, Row('foremost - tip', 0.1), Row('foremost - tip', 0.002, 'tanh'),
    *_MEMORY, Row('speed', 0.1), _AHEAD,
    Row('at.cut', 0.03, at=AT_TOOL), Row('at.surface - height', 0.05, at=AT_TOOL),
    Row('at.surface - at.cut - height', 0.02, 'tanh', at=AT_TOOL),
    Row('at.since', RECENT, 'fade', at=AT_TOOL),
    *(Row('at.surface - height', 0.05, squash, at=(0.0,)) for squash in ('relu', 'relu2')),
    Row(_GAP, 0.002, 'tanh', at=(0.0,)), Row(_GAP, 0.0005, 'tanh', at=(0.0,)),
)  # fmt: skip
# How a neighbour differs from a strip.
_SIDE = (Row('at.beside - at.surface + at.cut', 0.03, at=AT_TOOL),)
_STANDS = (
    Row('at.surface - height', 0.05, at=(0.0,)),
    Row('height - at.surface', 0.03, 'relu', at=(0.0,)),
    *_AREA, Row('foremost - tip', 0.1), _AHEAD,
)  # fmt: skip
_PAST_END, _ABOVE_CUT = 'abs(z) - half_width', 'y - surface + cut'
_HERE = (
    Row('tip - u', 0.15), Row('tip - u', 0.03, 'tanh'),
    *(Row('tip - u', 0.05, 'bell', shift) for shift in (-0.08, 0.0, 0.08)),
    Row('abs(z)', 0.15), Row(_PAST_END, 0.03, 'tanh'), Row(_PAST_END, 0.1, 'tanh'),
    Row(_PAST_END, 0.008, 'tanh'), Row(_PAST_END, 0.02, 'bell'),
    Row('foremost - u', 0.15), Row('foremost - u', 0.03, 'tanh'),
    Row('area_before', 0.01), Row('sqrt(area_before + 1e-6)', 0.1),
    Row('surface - height', 0.05),
    Row('at.cut', 0.03, at=AROUND), Row('at.surface - surface', 0.03, at=AROUND),
    Row('at.since', RECENT, 'fade', at=SINCE_AROUND),
)  # fmt: skip
_OF_PARTICLE = (
    Row('y - surface', 0.05), Row('y - height', 0.05), Row('y - height', 0.02, 'tanh'),
    Row(_ABOVE_CUT, 0.05), Row(_ABOVE_CUT, 0.01, 'tanh'),
    # Sharper where a particle is carried along or left.
    Row(_ABOVE_CUT, 0.004, 'tanh'), Row(_ABOVE_CUT, 0.012, 'bell'),
)  # fmt: skip


class Tables(NamedTuple):
    """All inputs of the networks of a tool.

    Attributes:
      load, side: of a strip, and of a strip with a neighbour.
      here: of a place, for surface and soil.
      particle: of a particle, behind `here`.
      tool: of all places of a frame, behind these.
    """

    load: Table
    side: Table
    here: Table
    particle: Table
    tool: Table


TABLES = {
    name: Tables(
        Table((*own, *_LOAD)), Table(_SIDE), Table(_HERE, 'u'), Table(_OF_PARTICLE, 'u'),
        Table((*own, *_STANDS)),
    )
    for name, own in (('blade', _BLADE), ('wheel', _WHEEL))
}  # fmt: skip
