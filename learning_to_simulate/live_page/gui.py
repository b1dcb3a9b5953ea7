"""`Panel`: sliders, buttons, keys, lamp, chart and height map of the page."""

import collections

import numpy as np
from viser import uplot

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
    """The panel at the side of a `page.Page`; `names` are the models to choose from."""

    def __init__(self, page, gui, names, name: str):
        self._page, self._gui = page, gui
        self._lamp = gui.add_html('')
        self.model = gui.add_dropdown('scene / model', tuple(names), initial_value=name)
        self.model.on_update(self._by_user(page.choose_model))
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
        self._made, self._sliders, page = [], {}, self._page
        runs = session.recorded.runs if session.recorded else ()
        self.run = self._add('dropdown', page.reset, 'path', (BY_HAND, *runs))
        acts = {
            'Reset': ('R', lambda: page.reset(self.run.value)), 'Pause': ('P', page.pause),
            'Download': ('D', None),
        }  # fmt: skip
        buttons = self._add('button_group', None, '', tuple(acts))
        buttons.on_click(lambda event: self._clicked(acts[event.target.value][1], event))
        for label, (key, act) in acts.items():
            command = self._add('command', None, label, hotkey=key)
            command.on_trigger(lambda event, act=act: self._clicked(act, event))
        with self._add('folder', None, 'Tool'):
            if session.steering is not None:
                for (name, slider), keys in zip(session.steering.sliders.items(), KEYS):
                    self._slider(name, slider, keys)
            self._start_of(session)
        self.chart = None
        if session.scene.has_force:
            self.chart = self._add(
                'uplot', None, (np.zeros(1),) * len(LINES), LINES, title='Force on the tool',
                scales={'x': {'time': False}}, height=180, legend=uplot.Legend(live=False),
            )  # fmt: skip
        self.heights = self._add('image', None, page.height_picture(), label='height map')
        self._add('html', None, drawing.LEGENDS)
        self.ghost = self._add('checkbox', page.show_ghost, "solver's soil (blue)", True)
        self._add(
            'checkbox', lambda value: setattr(page.session, 'within', value), 'keep to training',
            session.within, hint=WITHIN,
        )  # fmt: skip
        keys = ', '.join(f'{a}/{b} {name}' for name, (a, b) in zip(self._sliders, KEYS))
        self._add('markdown', None, HELP.format(keys=keys))

    def _add(self, kind, changed, *values, **options):
        """An element of viser's that goes with the model; `changed(value)` when a user moves it."""
        handle = getattr(self._gui, f'add_{kind}')(*values, **options)
        if changed is not None:
            handle.on_update(self._by_user(changed))
        self._made.append(handle)
        return handle

    def _clicked(self, act, event):
        if act is not None:
            self._page.do(act)
            return
        # In a thread of viser's pool: the frames go on meanwhile.
        try:
            content = self._page.rollout_file()
        except (ValueError, OSError) as error:
            event.client.add_notification('No rollout', str(error), color='red')
            return
        event.client.send_file_download('rollout.npz', content, save_immediately=True)

    def _slider(self, name, slider, keys):
        self._sliders[name] = self._add(
            'slider', lambda value: self._steer(name, value), slider.label, slider.low,
            slider.high, slider.step, slider.value,
        )  # fmt: skip
        coarse = max(COARSE * slider.step, (slider.high - slider.low) / 40)
        for way, step, key in zip(('less', 'more'), (-coarse, coarse), keys):
            command = self._add('command', None, f'{way} {name}', hotkey=key)
            command.on_trigger(
                lambda _, step=step: self._page.do(lambda: self._nudge(name, step))
            )  # fmt: skip

    def _steer(self, name, value):
        self._page.take_over()
        steering = self._page.session.steering
        steering.set(name, value)
        self._shown[name] = steering.sliders[name].value

    def _nudge(self, name, step):
        self._page.take_over()
        steering = self._page.session.steering
        steering.set(name, steering.sliders[name].value + step)

    def _start_of(self, session):
        """Context values and, where there are several, the starts to choose from."""
        starts = session.model.starts
        for i, name in enumerate(session.scene.context_names):
            low, high = starts.context[:, i].min(), starts.context[:, i].max()
            high = high if high > low else low + abs(low) * 0.01 + 1e-3
            self._sliders[f'context {name}'] = self._add(
                'slider', lambda value, name=name: self._context(name, value),
                f'{name} (restarts)', float(low), float(high), float(high - low) / 200,
                session.context[name],
            )  # fmt: skip
        cases, self._start = start_names(starts), None
        if len(cases) > 1:
            self._start = self._add(
                'dropdown', lambda value: self._page.reset(start=cases.index(value)),
                'bed and body', cases,
            )  # fmt: skip

    def _context(self, name, value):
        self._page.reset(context=self._page.session.context | {name: value})

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
        """Shows status and values."""
        self._html(drawing.lamp(session, rate))

    def say(self, colour: str, text: str) -> None:
        """Shows a text in place of the status."""
        self._html(f'<div role="status" style="padding:4px 12px;color:{colour}">{text}</div>')

    def _html(self, content):
        if content != self._said:
            self._said = self._lamp.content = content


def start_names(starts) -> tuple[str, ...]:
    """Names of the starts: the numbers in which their cases differ."""
    rows = [{k: v for k, v in case.items() if isinstance(v, (int, float))} for case in starts.cases]
    keys = [k for k in rows[0] if k != 'case' and len({row.get(k) for row in rows}) > 1]
    return tuple(
        f'{i}: ' + ', '.join(f'{k.split("_")[0]} {row[k]:.4g}' for k in keys if k in row)
        for i, row in enumerate(rows)
    )
