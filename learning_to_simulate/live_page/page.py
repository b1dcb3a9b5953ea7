"""`Page`: a session in browsers, by viser: the scene, and the frames. `Panel` is at its side.

The callbacks of the network only set wishes: numbers of the steering, or a command in a queue. The
frames are computed by the thread that calls `Page.run`. All browsers see and steer one soil.
"""

import collections
import queue
import threading
import time

import numpy as np
import viser

from learning_to_simulate.live_page import drawing
from learning_to_simulate.live_page.gui import BY_HAND, Panel
from learning_to_simulate.live_page.session import STOPPED, Session

# Frames between updates of what need not move at the frame rate.
CHART_EVERY, GHOST_EVERY, HEIGHT_EVERY, LAMP_EVERY = 6, 3, 15, 6
CELL = 1.6  # of the height map, in spacings of the particles: smaller ones would be empty
GHOST_COLOUR, FORCE_COLOUR, BODY_COLOUR = (70, 140, 255), (230, 60, 60), (120, 130, 145)
LATE = 0.1  # s; frames that come later than that are lost, not bunched


class Page:
    """The page and its server.

    Args:
      load: makes a `Session` of a model's name.
      names: of the models that can be chosen.
      name: of the first one.
      host, port: to listen at.

    Attributes:
      server: `viser.ViserServer`.
      session: the session that is shown.
      turns: how many frames were due so far; nothing moves in those without a browser.

    Raises:
      ValueError, FileNotFoundError: as `load`.
    """

    def __init__(self, load, names, name: str, host: str = 'localhost', port: int = 8080):
        self._load, self._commands = load, queue.SimpleQueue()
        self.session: Session = load(name)
        self._filing, self._ended = threading.Lock(), threading.Event()
        self.server = viser.ViserServer(host, port, label=name, verbose=False)
        self.server.gui.configure_theme(show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self._dragging = self._paused = False
        self._frames = self.turns = 0
        self._recent: collections.deque = collections.deque(maxlen=61)
        self.panel = Panel(self, self.server.gui, names, name)
        self._show(name)
        self.server.on_client_disconnect(self._left)

    def run(self) -> None:
        """Computes frames at the rate of the model until `stop`; an error in one ends it."""
        due = time.monotonic()
        while not self._ended.is_set():
            self._recent.append(time.monotonic())
            self.frame()
            self.turns += 1
            due = max(due + self.session.scene.dt, time.monotonic() - LATE)
            self._ended.wait(max(0.0, due - time.monotonic()))

    def stop(self) -> None:
        """Ends frames and server; any thread."""
        self._ended.set()
        self.server.stop()

    def do(self, command) -> None:
        """Has a function called between two frames; any thread."""
        self._commands.put(command)

    # Commands, between two frames.

    def choose_model(self, name: str) -> None:
        """Shows another model; the old one stays where that fails, and the page says why."""
        if name == self._name:
            return
        try:
            self.panel.say('#888', f'loading {name} ...')
            session = self._load(name)
        except (ValueError, OSError) as error:
            self.panel.notify('The model cannot be shown', str(error))
            self.panel.model.value = self._name
            return
        self.session = session
        self._show(name)

    def reset(self, run: str | None = None, **options) -> None:
        """As `Session.reset`, with its error as a notice."""
        try:
            self.session.reset(None if run in (None, BY_HAND) else run, **options)
        except ValueError as error:
            self.panel.notify('This start is not possible', str(error))
        self._restart()

    def pause(self, paused: bool | None = None) -> None:
        """Stops the time, or lets it go on; None for the other of the two."""
        self._paused = not self._paused if paused is None else paused
        if self._paused:
            self.panel.say('#888', 'paused: P goes on')

    def take_over(self) -> None:
        """A slider or the handle was touched during a recorded run."""
        if self.session.run is not None:
            self.session.take_over()
            self.panel.run.value = BY_HAND
            self._ghost.visible = False

    def show_ghost(self, wanted: bool) -> None:
        """Shows or hides the solver's soil, where there is one."""
        self._ghost.visible = wanted and self.session.run is not None

    def rollout_file(self) -> bytes:
        """As of `Session`, one at a time."""
        with self._filing:
            return self.session.rollout_file()

    # The scene.

    def _show(self, name):
        """Builds scene and panel of the session anew."""
        self._name, session = name, self.session
        scene, server, up = self.server.scene, self.server, self.session.scene.up_axis
        scene.reset()
        scene.set_up_direction(np.eye(3)[up])
        low, high = session.rest.min(axis=0), session.rest.max(axis=0)
        self._middle = (low + high) / 2
        spacing = (np.prod(high - low) / len(session.rest)) ** (1 / 3)
        size = float((high - low).max())
        at_rest = session.rest - self._middle
        cloud = {'point_size': 0.45 * spacing, 'point_shape': 'circle', 'position': self._middle}
        self._shade = drawing.shades(len(session.rest))
        colours = drawing.soil_colours(session.rest, session.rest, self._shade)
        self._soil = scene.add_point_cloud('/soil', at_rest, colours, **cloud)
        cloud['point_size'] = 0.22 * spacing
        self._ghost = scene.add_point_cloud(
            '/solver', at_rest, GHOST_COLOUR, **cloud, visible=False
        )
        self._arrow_scale = size / (session.model.starts.force_limit or 100.0)
        self._arrow = scene.add_arrows(
            '/force', np.zeros((1, 2, 3), np.float32), FORCE_COLOUR, shaft_radius=0.008 * size,
            head_radius=0.018 * size, head_length=0.04 * size, visible=False,
        )  # fmt: skip
        self._handle = None
        if session.steering is not None:
            active = [False] * 3
            active[0], active[up] = session.steering.handle
            self._handle = scene.add_transform_controls(
                '/handle', scale=0.2 * size, active_axes=tuple(active), depth_test=False
            )
            self._handle.on_update(self._dragged)
        view = np.array([0.25 * session.forwards, 0.0, 1.0]) * size
        if up == 2:
            view = view[[0, 2, 1]] * (1, -1, 1)
        view[up] = 0.55 * size
        cameras = [client.camera for client in server.get_clients().values()]
        for camera in (server.initial_camera, *cameras):
            camera.position, camera.look_at = self._middle + view, self._middle
        self._cells = np.maximum(1, np.delete(high - low, up) / (CELL * spacing)).astype(int)
        self.panel.build(session)
        self._restart()

    def _restart(self):
        """After a reset: another body, other sliders, an empty chart."""
        vertices, faces = drawing.hull(self.session.body())
        self._body = self.server.scene.add_mesh_simple(
            '/tool', vertices, faces, color=BODY_COLOUR, flat_shading=True
        )
        self.show_ghost(self.panel.ghost.value)
        self._frames, self._dragging = 0, False
        self.panel.restarted(self.session)
        self._draw()

    async def _dragged(self, event):
        """The handle was moved: the body shall go there. On the loop of the network, in order."""
        if event.phase == 'start':
            self._dragging = True
        plane = self.session.plane_of(np.concatenate([event.target.position, event.target.wxyz]))
        self.do(lambda: self._aim(plane))
        if event.phase == 'end':
            self._dragging = False

    def _aim(self, plane):
        self.take_over()
        self.session.steering.aim(plane)

    def _left(self, _):
        # A browser that closes in the middle of a drag sends no end of it.
        self._dragging = False
        if not self.server.get_clients():  # The next visitor shall not find a tool that drives.
            self.do(lambda: self.pause(True))

    def frame(self) -> None:
        """One turn: applies the inputs of the browsers, steps, sends what they draw."""
        while not self._commands.empty():
            self._commands.get()()
        if self._paused or not self.server.get_clients():
            return
        self.session.advance()
        self._frames += 1
        self._draw()

    def _draw(self):
        session, moment, n = self.session, self.session.moment, self._frames
        with self.server.atomic():
            self._soil.points = moment.particles - self._middle
            self._body.position, self._body.wxyz = moment.pose[:3], moment.pose[3:]
            if self._handle is not None and not self._dragging:
                self._handle.position = moment.pose[:3]
                # The arrow of a wheel points along its way, however far it has turned.
                can_turn = session.steering.handle[1]
                self._handle.wxyz = moment.pose[3:] if can_turn else (1.0, 0.0, 0.0, 0.0)
            if moment.force is not None:
                ends = np.stack([moment.pose[:3], moment.pose[:3]])
                ends[1] += self._arrow_scale * moment.force
                self._arrow.points = ends[None].astype(np.float32)
                self._arrow.visible = bool(np.linalg.norm(ends[1] - ends[0]) > 1e-3)
            if n % GHOST_EVERY == 0 and self._ghost.visible:
                truth = session.run.particles(min(moment.frame, len(session.run) - 1))
                self._ghost.points = truth - self._middle
            if n % CHART_EVERY == 0:
                colours = drawing.soil_colours(moment.particles, session.rest, self._shade)
                self._soil.colors = colours
            if n % HEIGHT_EVERY == 0:
                self.panel.heights.image = self.height_picture()
        self.panel.record(session)
        if n % CHART_EVERY == 0:
            self.panel.draw_chart()
            self.panel.show_sliders(session)
        if n % LAMP_EVERY == 0 or moment.lamp == STOPPED:
            recent = list(self._recent)
            rate = (len(recent) - 1) / max(recent[-1] - recent[0], 1e-3) if recent else 0.0
            self.panel.show_lamp(session, rate)

    def height_picture(self):
        """uint8 picture of the height map of the newest frame."""
        heights = self.session.height_map(*self._cells) - self.session.level
        return drawing.height_picture(heights, self.session.forwards)
