"""Soil under a machine in MuJoCo: tools on a terrain, their loads back into `mjData`.

MuJoCo has Z up where this project has y up: X = x, Y = -z, Z = y (docs/axes.md).

The load of a soil field belongs to the frame of 1/60 s to which the tool is about to go on, as in
the data that taught it, and it changes within half a millimetre. So a step of h solves for load and
motion together. With w the loads of all tools, w_0 those of the step before, q_0 where MuJoCo takes
the tools under w_0 (a trial step with its joints, contacts and actuators), q where they are now, J3
the Jacobian of along, up and lean of the tools and J6 that of places and turns,

  s = h^2 C (w(q + (q_0 + s - q) / (60 h)) - w_0),    C = J3 M^-1 J6^T,                        (1)

is how far the change of the loads moves the tools within the step. Newton's method finds s with
derivatives of w from proposed frames, kept from step to step by Broyden's update, and without what
would push a tool on in the direction in which it goes.

w holds the damping D of a tool that rests (`soil_field/loaded.py`). Its mass is M = 1 / C along up;
it is pressed down by the load of w_0 less M a, with a its acceleration up under w_0. Explicit
coupling applies load and damping of the newest frames; the damping's coefficient is then at most
M / 2 h.
"""

import contextlib
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from learning_to_simulate.live.poses import turned
from learning_to_simulate.rollout_status import OK, Judgement, RolloutStatus, worse
from learning_to_simulate.soil_field.engine import FASTEST, FASTEST_TURN, SoilFrame, refuse_step
from learning_to_simulate.soil_field.loaded import Damping
from learning_to_simulate.soil_field.place import UP
from learning_to_simulate.soil_field.stepper import DT, SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain

TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
# It has one number a row: rows of numbers are turned by picking columns, in a third of the time.
_TO, _TO_SIGN = np.abs(TO_Z_UP).argmax(axis=1), TO_Z_UP.sum(axis=1)
_FROM, _FROM_SIGN = np.abs(TO_Z_UP.T).argmax(axis=1), TO_Z_UP.T.sum(axis=1)
_WRENCH = np.append(_TO, 3 + _TO), np.tile(_TO_SIGN, 2)  # force and torque, to Z up
_POSE = np.r_[_FROM, 3, 4 + _FROM], np.r_[_FROM_SIGN, 1.0, _FROM_SIGN]  # place and turn, from it
# Of (1): tolerance and reach of differences, m (a turn counts as 0.1 m times its angle); rounds.
TOLERANCE, REACH, ROUNDS = 2e-7, 1e-4, 12
EAGER = 3  # rounds with the full tolerance; later ones accept a hundred times that
PRESSED = DT / 4  # s for which what presses on a tool is taken to stay
ARM = np.array([1.0, 1.0, 0.1])
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(2, 0, 1)  # a x b, in a fifth of the time
# Clearance to all soil about a tool above which no speed is too fast, m.
CLEAR = 0.1
# m of height that a height field can show over and under the terrain as it was.
ROOM = 1.0
FIELD = 'soil'  # name of the height field
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_SLOW = np.repeat([FASTEST / 3**0.5, FASTEST_TURN / 4], [3, 4])  # of the parts of a pose


def add_height_field(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    """Adds a height field of a terrain to a model, which nothing collides with, for
    `MujocoSoil.draw`."""
    heights = terrain.heights
    if min(heights.shape) < 2:
        raise ValueError(f'a height field needs 2 x 2 cells, the terrain has {heights.shape}')
    base, top = heights.min() - ROOM, heights.max() + ROOM
    x, z = terrain.corner + terrain.cell * heights.shape / 2
    half = terrain.cell * (np.array(heights.shape) - 1) / 2
    spec.add_hfield(
        name=FIELD, ncol=heights.shape[0], nrow=heights.shape[1], size=[*half, top - base, 0.05],
        userdata=list(_rows(heights, base, top)),
    )  # fmt: skip
    spec.worldbody.add_geom(
        name=FIELD, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=FIELD, pos=[x, -z, base],
        contype=0, conaffinity=0, rgba=[0.62, 0.47, 0.32, 1.0],
    )  # fmt: skip


def _rows(heights, base, top):
    """Heights [nx, nz] as MuJoCo keeps them: rows from the lowest Y on, from 0 to 1."""
    return np.clip((heights.T[::-1] - base) / (top - base), 0.0, 1.0).astype(np.float32).ravel()


class MujocoSoil:
    """Tools of a machine in MuJoCo, on one terrain.

    Args:
      model, data: of MuJoCo.
      tools: name of a site or body -> `SoilStepper` of the tool there. Its frame is that of the
        tool: the origin in the reference point (edge of a blade, axle of a wheel), Z up and -X the
        way where the tool looks when it is upright.
      implicit: False applies the loads of the step before; for comparison.

    Attributes:
      frames: name -> newest `SoilFrame`, in axes of this project, with the damping of a tool that
        rests in its force; {} before `start`.
      wrenches: float64 [n, 6] force and torque about the centre of mass of the tools' bodies, N
        and N m, Z up, as applied in the last step.
      rounds, gap: evaluations of (1) in the last step, and what was left of it, m.

    Raises:
      ValueError: no tool, an unknown name, no stepper, steppers of several terrains, gravity that
        is not that of the soil, a time step that is too long.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, tools: Mapping[str, SoilStepper],
        implicit: bool = True,
    ):  # fmt: skip
        if not tools:
            raise ValueError('tools is empty: name of a site or body -> stepper was expected')
        for name, stepper in tools.items():
            if not isinstance(stepper, SoilStepper):
                raise ValueError(
                    f'{name}: a stepper was expected, not a {type(stepper).__name__}: a model '
                    f'knows a Blade or a Wheel, no mesh; give model.stepper(terrain, tool)'
                )
        self._model, self._data, self._implicit = model, data, implicit
        self._names, self._steppers = list(tools), list(tools.values())
        self.terrain = self._steppers[0].terrain
        if any(stepper.terrain is not self.terrain for stepper in self._steppers):
            raise ValueError('the steppers stand on several terrains, must share one')
        gravity = np.array([0.0, 0.0, -self.terrain.soil.gravity])
        if np.abs(model.opt.gravity - gravity).max() > 0.01 * self.terrain.soil.gravity:
            raise ValueError(
                f'gravity of the model is {model.opt.gravity}, of the soil {gravity} m/s2: set '
                f'<option gravity=.../> or lts.Soil(gravity=...)'
            )
        self._check_time()
        self._spots = [self._spot(name) for name in self._names]
        self._bodies = np.array([body for _, _, body in self._spots])
        self._scale = np.tile(ARM, len(tools))
        self._radii = np.array([stepper.tool.radius for stepper in self._steppers])
        self.frames: dict[str, SoilFrame] = {}
        self.wrenches = np.zeros((len(tools), 6))
        self.rounds, self.gap = 0, 0.0
        self._forget()

    def _forget(self):
        """Begins a run."""
        self._loads = np.zeros_like(self.wrenches)  # about the places of the tools, axes of lts
        self._slopes: list[Any] = [None] * len(self._names)
        self._damping, self._waited = [Damping() for _ in self._names], np.inf
        # The worst status of each tool until it last began a new passage in the air.
        self._worst = dict.fromkeys(self._names, OK)

    def _check_time(self):
        if not 0 < self._model.opt.timestep <= DT * (1 + 1e-6):
            raise ValueError(
                f'the time step is {self._model.opt.timestep} s, must lie in (0, {DT:.4f}]: a '
                f'frame of training; set <option timestep=.../>'
            )

    def _spot(self, name):
        """Whether a name is that of a site, its number, and the number of its body."""
        for is_site, kind in ((True, mujoco.mjtObj.mjOBJ_SITE), (False, mujoco.mjtObj.mjOBJ_BODY)):
            number = mujoco.mj_name2id(self._model, kind, name)
            if number >= 0:
                body = self._model.site_bodyid[number] if is_site else number
                return is_site, number, int(body)
        m = self._model
        known = [m.site(i).name for i in range(m.nsite)] + [m.body(i).name for i in range(m.nbody)]
        raise ValueError(f'no site or body {name!r}; there are {", ".join(filter(None, known))}')

    def _poses(self):
        """Poses [n, 7] of the tools, axes of this project, from the kinematics in `data`."""
        d, found = self._data, np.empty((len(self._spots), 7))
        for row, (is_site, number, _) in zip(found, self._spots, strict=True):
            if is_site:
                row[:3] = d.site_xpos[number]
                mujoco.mju_mat2Quat(row[3:], d.site_xmat[number])
            else:
                row[:3], row[3:] = d.xpos[number], d.xquat[number]
        return found[:, _POSE[0]] * _POSE[1]

    def start(self) -> dict[str, SoilFrame]:
        """Sets the tools down where they are in `data`; loads of an earlier run leave it.

        Raises:
          ValueError: see `SoilStepper.start`; with the name of the tool.
        """
        self._apply(np.zeros_like(self.wrenches))
        mujoco.mj_forward(self._model, self._data)
        self._forget()
        found = {}
        for name, stepper, pose in zip(self._names, self._steppers, self._poses(), strict=True):
            with _naming(name):
                found[name] = stepper.start(pose)
        self.frames = found
        self._loads = np.stack([_load(frame) for frame in found.values()])
        return found

    @property
    def judgement(self) -> Judgement:
        """The worst of all tools since the start, with the name of the tool in its reason."""
        found = OK
        for name, frame in self.frames.items():
            now = frame.judgement
            if now.status != RolloutStatus.OK:
                now = now._replace(reason=f'{name}: {now.reason}')
            found = worse(found, now)
        return found

    def step(self) -> dict[str, SoilFrame]:
        """One step of MuJoCo (instead of `mj_step`), with the soil.

        Raises:
          ValueError: before `start`, or a pose that a tool cannot reach in soil (see
            `SoilStepper.step`); machine, soil and tools stay as they were.
        """
        if not self.frames:
            raise ValueError('the tools stand nowhere yet: call start()')
        self._check_time()
        m, d = self._model, self._data
        state = np.empty(mujoco.mj_stateSize(m, _STATE))
        mujoco.mj_getState(m, d, state, _STATE)
        wrenches, dt = self.wrenches, m.opt.timestep
        try:
            mujoco.mj_kinematics(m, d)
            mujoco.mj_comPos(m, d)
            levers = self._levers()
            loads, damped = self._loads, np.zeros(len(self._names))
            if self._implicit:
                loads, damped = self._solved(state, levers, dt)
            elif self._waited >= PRESSED:
                self._answers(dt)
            self._apply(_about_centres(loads, levers))
            mujoco.mj_step(m, d)
            mujoco.mj_kinematics(m, d)
            poses = self._poses()
            airy = self._fly(poses, dt)
        except ValueError:
            mujoco.mj_setState(m, d, state, _STATE)
            self.wrenches = wrenches
            mujoco.mj_forward(m, d)
            raise
        for j, (name, stepper, pose, flies) in enumerate(
            zip(self._names, self._steppers, poses, airy, strict=True)
        ):
            rate = (pose[1] - stepper.frame.pose[1]) / dt
            if flies:  # a new start, which forgets what was judged before
                self._worst[name] = worse(self._worst[name], stepper.frame.judgement)
            frame = stepper.start(pose) if flies else stepper.step(pose, dt)
            if self._worst[name] is not OK:
                frame = frame._replace(judgement=worse(self._worst[name], frame.judgement))
            if not self._implicit:
                damped[j] = self._damping[j].force(frame.force[1], rate)
            self._damping[j].go_on(frame.force[1], rate, dt)
            if damped[j]:
                frame = frame._replace(force=frame.force + damped[j] * UP)
            self.frames[name] = frame
        self._waited += dt
        self._loads = loads if self._implicit else np.stack([*map(_load, self.frames.values())])
        return self.frames

    def _levers(self):
        """[n, 3]: from the centre of mass of the body to the tool, Z up."""
        d = self._data
        return np.array([
            (d.site_xpos if is_site else d.xpos)[number] - d.xipos[body]
            for is_site, number, body in self._spots
        ])  # fmt: skip

    def _apply(self, wrenches):
        """Puts loads in the place of those of the step before; the user's own stay."""
        np.add.at(self._data.xfrc_applied, self._bodies, wrenches - self.wrenches)
        self.wrenches = wrenches

    def _fly(self, poses, dt):
        """Which of the tools [n] go farther than a step allows, in the air; ValueError where one
        does so in soil."""
        last = np.array([stepper.frame.pose for stepper in self._steppers])
        # The way is at most sqrt(3) times its largest part, the angle 4 times that of unit
        # quaternions.
        is_slow = (np.abs(poses - last) < 0.9 * dt * _SLOW).all()
        if is_slow and (poses[:, 1] - self._radii > self.terrain.floor).all():
            return [False] * len(poses)  # as `refuse_step` says of each, in ten times as long
        flies = [False] * len(poses)
        for j, (name, stepper) in enumerate(zip(self._names, self._steppers, strict=True)):
            try:
                refuse_step(poses[j], last[j], dt, stepper.tool, self.terrain)
            except ValueError:
                flies[j] = self._is_clear(stepper, poses[j])
                if not flies[j]:
                    with _naming(name):
                        raise
        return flies

    def _is_clear(self, stepper, pose):
        terrain, tool = self.terrain, stepper.tool
        reach = tool.width / 2 + tool.radius + CLEAR
        i, k = ((pose[[0, 2]] - terrain.corner) / terrain.cell).astype(int)
        a, b = np.ceil(reach / terrain.cell).astype(int)
        rows, columns = (
            slice(*np.clip([at - n, at + n + 1], [0, 1], [size - 1, size]))
            for at, n, size in zip((i, k), (a, b), terrain.shape, strict=True)
        )
        return pose[1] - tool.radius > terrain.heights[rows, columns].max() + CLEAR

    def _solved(self, state, levers, dt):
        """Loads [n, 6] of (1), and what of them is damping [n], N up."""
        m, d, n = self._model, self._data, len(self._names)
        wrenches = self.wrenches
        self._apply(_about_centres(self._loads, levers))
        mujoco.mj_step(m, d)
        # Jacobians and inertia in `data` are still those of the begin of the step.
        axes, inner, answer = self._answers(dt)
        give = dt * dt * inner.reshape(3 * n, m.nv) @ answer.T
        mujoco.mj_kinematics(m, d)
        far = max(1.0, DT / dt)
        last = np.array([stepper.frame.pose for stepper in self._steppers])
        reached = self._poses()
        poses, rises = _ahead(last, reached, far), (reached - last)[:, 1].tolist()
        mujoco.mj_setState(m, d, state, _STATE)
        self.wrenches = wrenches  # as `data` has them again

        def loads_at(s):
            ways = far * s.reshape(n, 3)
            return np.array([
                self._proposed(j, _moved(poses[j], axes[j], ways[j])) for j in range(n)
            ])  # fmt: skip

        before, scale = self._loads.ravel(), self._scale

        def damped(s, loads):
            return np.array([
                self._damping[j].force(loads[j, 1], (rises[j] + s[3 * j + 1]) / dt)
                for j in range(n)
            ])  # fmt: skip

        def gap_of(s, loads):
            all_of = loads.copy()
            all_of[:, 1] += damped(s, loads)
            return s - give @ (all_of.ravel() - before)

        s = np.zeros(3 * n)
        try:
            loads = loads_at(s)
        except ValueError:  # loads of the step before may throw a light tool far into the air
            s = -give @ before
            loads = loads_at(s)
        gap = gap_of(s, loads)
        fresh = [False] * n
        for self.rounds in range(1, ROUNDS + 1):
            self.gap = float(np.abs(scale * gap).max())
            if self.gap <= (TOLERANCE if self.rounds <= EAGER else 100 * TOLERANCE):
                break
            slope = np.zeros((6 * n, 3 * n))
            for j in range(n):
                if not loads[j].any():
                    self._slopes[j] = None
                    continue
                if self._slopes[j] is None:
                    there = _moved(poses[j], axes[j], far * s[3 * j : 3 * j + 3])
                    self._slopes[j] = self._differences(j, there, axes[j], loads[j])
                    fresh[j] = True
                own = far * _resisting(self._slopes[j], axes[j])
                damps, most = damped(s, loads)[j], loads[j, 1]
                if damps <= -most:  # as much as it bears
                    own[1] = 0.0
                elif damps < 0.0:
                    own[1, 1] -= self._damping[j].coefficient / dt
                slope[6 * j : 6 * j + 6, 3 * j : 3 * j + 3] = own
            way = -np.linalg.solve(np.eye(3 * n) - give @ slope, gap)
            share = 1.0
            while share > 0.01:
                try:
                    coming = loads_at(s + share * way)
                except ValueError:  # farther than a tool may go
                    share /= 4
                    continue
                left = gap_of(s + share * way, coming)
                self._learn(coming - loads, share * far * way)
                if np.abs(scale * left).max() < self.gap:
                    s, loads, gap = s + share * way, coming, left
                    fresh = [False] * n
                    break
                share /= 4
            else:
                if all(fresh[j] or not loads[j].any() for j in range(n)):
                    break  # as near as it gets
                self._slopes = [None] * n
        damps = damped(s, loads)
        loads[:, 1] += damps
        return loads, damps

    def _answers(self, dt):
        """Axes [n, 3, 3] of the tools, Jacobians [n, 3, nv] of along, up and lean, and what unit
        loads change of the velocities of the joints per second [6 n, nv]. It calls `_press` from
        time to time."""
        m, d, n = self._model, self._data, len(self._names)
        jacobians = np.empty((n, 2, 3, m.nv))
        for jacobian, (is_site, number, _) in zip(jacobians, self._spots, strict=True):
            call = mujoco.mj_jacSite if is_site else mujoco.mj_jacBody
            call(m, d, *jacobian, number)
        whole = (TO_Z_UP.T @ jacobians).reshape(n, 6, m.nv)
        places = [stepper.place for stepper in self._steppers]
        axes = np.array([[place.along, UP, place.across] for place in places])
        inner = np.concatenate(
            [axes[:, :1] @ whole[:, :3], whole[:, 1:2], axes[:, 2:] @ whole[:, 3:]], axis=1
        )
        answer = np.zeros((6 * n, m.nv))
        mujoco.mj_solveM(m, d, answer, whole.reshape(6 * n, m.nv))
        if self._waited >= PRESSED:
            self._press(whole[:, 1], answer[1::6], dt)
            self._waited = 0.0
        return axes, inner, answer

    def _press(self, up, answer, dt):
        """Tells the damping of the tools what presses on them, from the Jacobian [n, nv] of their
        heights and the answer [n, nv] of the machine to a unit force up on each; `data` has the
        accelerations under `wrenches`."""
        m, d = self._model, self._data
        moment = np.zeros((m.nu, m.nv))
        mujoco.mju_sparse2dense(
            moment, d.actuator_moment, d.moment_rownnz, d.moment_rowadr, d.moment_colind
        )
        gives = np.maximum((up * answer).sum(axis=1), 1e-9)  # a tool that cannot rise is heavy
        mass, way = 1.0 / gives, answer / gives[:, None]  # kg; of the joints, per m up
        weights = self.wrenches[:, 2] - mass * (answer @ d.qfrc_smooth)
        lengths = (way @ moment.T) ** 2
        stiffness = way[:, m.jnt_dofadr] ** 2 @ m.jnt_stiffness - lengths @ m.actuator_biasprm[:, 1]
        damping = way**2 @ m.dof_damping - lengths @ m.actuator_biasprm[:, 2]
        held = np.abs(way @ d.qfrc_actuator)
        rows = np.stack([mass, weights, np.maximum(stiffness, 0.0), np.maximum(damping, 0.0), held])
        for one, row in zip(self._damping, rows.T.tolist(), strict=True):
            one.press(*row)
            if not self._implicit:  # takes no more than half of the speed within a step
                one.coefficient = min(one.coefficient, row[0] / dt / 2)

    def _learn(self, change, way):
        """Broyden's update of slopes: loads changed by [n, 6] along a way [3 n]."""
        for j, step in enumerate(way.reshape(-1, 3)):
            if self._slopes[j] is not None and step.any():
                metric = ARM**2 * step
                off = change[j] - self._slopes[j] @ step
                self._slopes[j] += np.outer(off, metric) / (metric @ step)

    def _proposed(self, j, pose):
        """Load [6] of a tool that would go to a pose."""
        stepper = self._steppers[j]
        try:
            return stepper.load(pose, DT)
        except ValueError:
            with _naming(self._names[j]):
                if not self._is_clear(stepper, pose):
                    raise
            return np.zeros(6)

    def _differences(self, j, pose, axes, load):
        """[6, 3] of loads by along, up and lean, N/m and so on."""
        columns = []
        for step in REACH * np.diag(1 / ARM):
            there = self._proposed(j, _moved(pose, axes, step))
            columns.append((there - load) / step.max())
        return np.stack(columns, axis=1)

    def draw(self, view=None) -> None:
        """Writes the terrain into its height field (see `add_height_field`), which a `view` shows:
        a `mujoco.Renderer` or the handle of a passive viewer; or None."""
        m, cells = self._model, np.prod(self.terrain.shape)
        number = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_HFIELD, FIELD)
        if number < 0 or m.hfield_ncol[number] * m.hfield_nrow[number] != cells:
            raise ValueError(
                f'the model has no height field {FIELD!r} of {self.terrain.shape} cells: call '
                f'add_height_field(spec, terrain) before spec.compile()'
            )
        base, start = float(m.geom(FIELD).pos[2]), m.hfield_adr[number]
        rows = _rows(self.terrain.heights, base, base + m.hfield_size[number][2])
        m.hfield_data[start : start + len(rows)] = rows
        if hasattr(view, 'update_hfield'):
            view.update_hfield(number)
        elif view is not None:
            mujoco.mjr_uploadHField(m, view._mjr_context, number)


@contextlib.contextmanager
def _naming(tool):
    """Puts the name of a tool before what is wrong with it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f'{tool}: {error}') from error


def _load(frame):
    return np.concatenate([frame.force, frame.torque])


def _about_centres(loads, levers):
    """Loads [n, 6] about the tools as wrenches about centres of mass, Z up."""
    found = loads[:, _WRENCH[0]] * _WRENCH[1]
    found[:, 3:] += np.einsum('ijk,nj,nk->ni', _CROSS, levers, found[:, :3])
    return found


def _moved(pose, axes, s):
    """A pose [7] after s [3] along, up (m) and in lean (rad)."""
    if not s.any():
        return pose
    found = np.empty(7)
    found[:3] = pose[:3] + s[:2] @ axes[:2]
    found[3:] = turned(pose[3:].tolist(), s[2] * axes[2])
    return found


def _ahead(last, poses, far):
    """Where tools that go from poses [n, 7] to others will be after so many times the way."""
    if far == 1.0:
        return poses
    way = poses - last
    way[:, 3:] = poses[:, 3:] - np.sign((last[:, 3:] * poses[:, 3:]).sum(1))[:, None] * last[:, 3:]
    found = poses + (far - 1.0) * way
    # Turns within a step are small: a chord is as long as its arc.
    found[:, 3:] /= np.sqrt((found[:, 3:] ** 2).sum(axis=1))[:, None]
    return found


def _resisting(slope, axes):
    """A slope [6, 3] without the part that pushes a tool on in the direction in which it goes."""
    rows = np.zeros((3, 6))
    rows[0, :3], rows[1, :3], rows[2, 3:] = axes
    own = (rows @ slope) / np.outer(ARM, ARM)
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    pushing = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return slope - rows.T @ (pushing * np.outer(ARM, ARM))
