"""The tools that drive through soil: numpy alone; the C form has the same functions.

axes: along the way, up and across; poses read from particles.
swept: what a circle has swept, the state that both tools share.
blade, wheel: one file a tool, with its pose, state, table of inputs and outline.
inputs: what a table of inputs is.
bed: heights of beds, and beds that are given.
path_memory: what a tool has done, as inputs of a network in the subspace.
"""

from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.tool.blade import Blade
from learning_to_simulate.tool.tool import Tool
from learning_to_simulate.tool.wheel import CONTEXT, Wheel

TOOLS: dict[str, type[Tool]] = {tool.name: tool for tool in (Blade, Wheel)}


def for_scene(scene) -> Tool:
    """The tool of a scene: a blade where all motion is given, a wheel where it is driven.

    Raises:
      ValueError: neither; a wheel whose load or soil is not known.
    """
    if scene.rigid_motion == RigidMotion.PRESCRIBED:
        return Blade()
    if scene.rigid_motion != RigidMotion.DRIVEN:
        raise ValueError(
            f'swept_field needs a tool whose motion is given: a blade (prescribed) or a wheel '
            f'(driven); the body is {scene.rigid_motion}'
        )
    if not set(CONTEXT) <= set(scene.context_names):
        raise ValueError(
            f'swept_field needs the context {CONTEXT} of a driven wheel; the scene has '
            f'{scene.context_names}'
        )
    return Wheel()
