"""`Panel`: sliders, buttons, keys, lamp, chart and height map of the page."""

import collections

import numpy as np

from learning_to_simulate.live_page import drawing

BY_HAND = 'by hand'
# Keys that lower and raise the sliders of a tool, in their order.
KEYS = (('J', 'U'), ('K', 'I'), ('L', 'O'))
SHOWN = 6.0  # s of the chart
WITHIN = 'The tool keeps to the places, angles and speeds of the training runs.'
# Of the chart; the last two are there while a recorded run is followed.
LINES = (
    {'label': 's'},
    {'label': 'drive, N', 'stroke': '#d33', 'width': 2},
    {'label': 'up, N', 'stroke': '#36c', 'width': 2},
    {'label': 'drive, solver', 'stroke': '#e99', 'dash': [4, 4]},
    {'label': 'up, solver', 'stroke': '#9be', 'dash': [4, 4]},
)
COARSE = 5  # steps of a slider that a key moves it by
HELP = (
    'Drag the arrows and the ring at the tool, or move the sliders. Without a mouse: Tab and the '
    'arrow keys, or {keys}; R reset, P pause, D download. Ctrl+K lists all keys.'
)


class Panel:
    """The panel at the side.

    Args:
      page: `page.Page`.
      gui: of viser.
      names: of the models that can be chosen.
      name: of the one that is shown.
    """

    def __init__(self, page, gui, names, name: str):
        self._page, self._gui = page, gui
        self._lamp = gui.add_html('')
        self.model = gui.add_dropdown('scene / model', tuple(names), initial_value=name)
        self.model.on_update(self._by_user(lambda value: page.choose_model(value)))
        self._made: list = []
        self._shown: dict[str, float] = {}
        self._said = ''

    def _by_user(self, act):
        """A callback that has `act(value)` called between two frames; not for values of ours.

        It is a coroutine, so that it reads the value before another one comes.
        """

        async def changed(event):
            if event.client_id is not None:
                value = event.target.value
                self._page.do(lambda: act(value))

        return changed

    def notify(self, title: str, text: str) -> None:
        """A notice in all browsers."""
        for client in self._page.server.get_clients().values():
            client.add_notification(title, text, color='red')

    def build(self, session) -> None:
        """Everything that depends on the model, anew."""
        for made in reversed(self._made):  # what is in a folder before the folder
            made.remove()
        self._made, self._sliders, page, gui = [], {}, self._page, self._gui

        def made(handle):  # type: ignore[no-redef]
            self._made.append(handle)
            return handle

        runs = (BY_HAND, *(session.recorded.runs if session.recorded else ()))
        self.run = made(gui.add_dropdown('path', runs))
        self.run.on_update(self._by_user(page.reset))
        acts = {
            'Reset': ('R', lambda: page.reset(self.run.value)), 'Pause': ('P', page.pause),
            'Download': ('D', None),
        }  # fmt: skip
        buttons = made(gui.add_button_group('', tuple(acts)))
        buttons.on_click(self._clicked(acts))
        for label, (key, act) in acts.items():
            if act:
                self._key(label, key, act)
        command = made(gui.add_command('Download rollout', hotkey='D'))
        command.on_trigger(self._download)
        with made(gui.add_folder('Tool')):
            if session.steering is not None:
                for (name, slider), keys in zip(session.steering.sliders.items(), KEYS):
                    made(self._slider(name, slider, keys))
            names = session.scene.context_names
            ranges = context_ranges(session)
            for name, (low, high) in zip(names, ranges):
                number = made(
                    gui.add_slider(
                        f'{name} (restarts)', low, high, (high - low) / 200,
                        session.context[name],
                    )
                )  # fmt: skip
                number.on_update(self._by_user(lambda value, name=name: self._context(name, value)))
                self._sliders[f'context {name}'] = number
            cases = start_names(session.model.starts)
            self._start = None
            if len(cases) > 1:
                self._start = made(gui.add_dropdown('bed and body', cases))
                self._start.on_update(
                    self._by_user(lambda value: page.reset(start=cases.index(value)))
                )
        self._chart_of(session, made)
        self.heights = made(gui.add_image(page.height_picture(), label='height map'))
        self.ghost = made(gui.add_checkbox("solver's soil (blue)", True))
        self.ghost.on_update(self._by_user(page.show_ghost))
        within = made(gui.add_checkbox('keep to training', session.within, hint=WITHIN))
        within.on_update(self._by_user(lambda value: setattr(page.session, 'within', value)))
        keys = ', '.join(f'{a}/{b} {name}' for name, (a, b) in zip(self._sliders, KEYS))
        made(gui.add_markdown(HELP.format(keys=keys)))

    def _clicked(self, acts):
        def clicked(event):
            _, act = acts[event.target.value]
            if act:
                self._page.do(act)
            else:
                self._download(event)

        return clicked

    def _slider(self, name, slider, keys):
        handle = self._gui.add_slider(
            slider.label, slider.low, slider.high, slider.step, slider.value
        )
        handle.on_update(self._by_user(lambda value: self._steer(name, value)))
        self._sliders[name] = handle
        for sign, key in zip((-1, 1), keys):
            way = 'less' if sign < 0 else 'more'
            self._key(f'{way} {name}', key, lambda sign=sign: self._nudge(name, sign))
        return handle

    def _key(self, label, key, act):
        command = self._gui.add_command(label, hotkey=key)
        command.on_trigger(lambda _: self._page.do(act))
        self._made.append(command)

    def _steer(self, name, value):
        self._page.take_over()
        steering = self._page.session.steering
        steering.set(name, value)
        self._shown[name] = steering.sliders[name].value

    def _nudge(self, name, sign):
        slider = self._page.session.steering.sliders[name]
        coarse = max(COARSE * slider.step, (slider.high - slider.low) / 40)
        self._page.take_over()
        self._page.session.steering.set(name, slider.value + sign * coarse)

    def _context(self, name, value):
        session = self._page.session
        self._page.reset(context=session.context | {name: value})

    def _download(self, event):
        """In a thread of viser's pool: the frames go on meanwhile."""
        try:
            content = self._page.rollout_file()
        except (ValueError, OSError) as error:
            event.client.add_notification('No rollout', str(error), color='red')
            return
        event.client.send_file_download('rollout.npz', content, save_immediately=True)

    def _chart_of(self, session, made):
        self.chart = None
        if not session.scene.has_force:
            return
        self.chart = made(
            self._gui.add_uplot(
                (np.zeros(1),) * len(LINES),
                LINES,
                title='Force on the tool',
                scales={'x': {'time': False}},
                height=180,
            )
        )

    def restarted(self, session) -> None:
        """After a reset."""
        self._rows: collections.deque = collections.deque(maxlen=round(SHOWN / session.scene.dt))
        if self._start is not None:
            self._start.value = start_names(session.model.starts)[session.start]
        for name, value in (session.context or {}).items():
            self._sliders[f'context {name}'].value = value
        if session.run is None:
            self.run.value = BY_HAND
        self.show_sliders(session, ranges=True)

    def show_sliders(self, session, ranges: bool = False) -> None:
        """Sets the sliders to what the steering says."""
        if session.steering is None:
            return
        for name, slider in session.steering.sliders.items():
            handle = self._sliders[name]
            if ranges:
                handle.min, handle.max = slider.low, slider.high
            if ranges or self._shown.get(name) != slider.value:  # else a drag would jump back
                self._shown[name] = handle.value = slider.value

    def record(self, session) -> None:
        """Keeps the forces of the newest frame."""
        moment = session.moment
        if moment.force is None or self._rows and self._rows[-1][0] == moment.time:
            return
        plan = [0, session.scene.up_axis]
        sign = np.array([session.forwards, 1.0])
        truth = ()
        if session.run is not None and session.run.force is not None:
            truth = session.run.force[min(moment.frame, len(session.run) - 1)][plan] * sign
        if self._rows and len(self._rows[-1]) != 3 + len(truth):
            self._rows.clear()  # the recorded run was left
        self._rows.append([moment.time, *(moment.force[plan] * sign), *truth])

    def draw_chart(self) -> None:
        """Draws what was kept."""
        if self.chart is not None and self._rows:
            data = tuple(np.array(self._rows).T.copy())
            with self._page.server.atomic():
                if len(self.chart.series) != len(data):
                    self.chart.series = LINES[: len(data)]
                self.chart.data = data

    def show_lamp(self, session, rate: float) -> None:
        """Shows the status, and how deep a wheel has sunk in."""
        moment, sinkage = session.moment, session.sinkage
        self._html(drawing.lamp(moment.lamp, moment.reason, rate, sinkage))

    def say(self, colour: str, text: str) -> None:
        """Shows a text in place of the status."""
        self._html(f'<div role="status" style="padding:4px 12px;color:{colour}">{text}</div>')

    def _html(self, content):
        if content != self._said:
            self._said = self._lamp.content = content


def context_ranges(session) -> list[tuple[float, float]]:
    """Lowest and highest of each context value: of the training runs, else of the starts."""
    starts = session.model.starts.context
    if starts is None:
        return []
    return [
        (float(low), float(high if high > low else low + abs(low) * 0.01 + 1e-3))
        for low, high in zip(starts.min(axis=0), starts.max(axis=0))
    ]


def start_names(starts) -> tuple[str, ...]:
    """Names of the starts: their cases, and what differs between them."""
    keys = [
        key
        for key in starts.cases[0]
        if key != 'case' and len({case.get(key) for case in starts.cases}) > 1
    ]
    return tuple(
        f'{i}: ' + ', '.join(f'{k.split("_")[0]} {case.get(k):.4g}' for k in keys if
                             isinstance(case.get(k), (int, float)))
        for i, case in enumerate(starts.cases)
    )  # fmt: skip
