"""Training of the three networks of a soil field, one after the other, from samples of runs.

Every draw of a step is a function of (seed, step); places of samples are one of the run's name.
Losses are (16) and (17) of docs/soil_field.md.
"""

import functools
import zlib

import numpy as np
import tensorflow as tf
import tqdm

from learning_to_simulate import command
from learning_to_simulate.soil_field import network, samples
from learning_to_simulate.soil_field.field import CONDITIONS, SoilField
from learning_to_simulate.soil_field.runs import Run
from learning_to_simulate.soil_field.settings import SCHEDULES, SoilFieldConfig
from learning_to_simulate.soil_field.tools import TOOLS, Blade, Wheel
from pca_tools import workers

CLIP_NORM = 1.0
FEW = 32  # runs: the start of a process takes as long as the samples of two
ROWS = 2048  # that a loss is computed of at a time
# How much errors of the six components of a load count: a torque by a lever of 0.1 to 0.3 m. The
# drawbar is what is asked of a wheel, and a fraction of what it bears.
COMPONENTS = {'blade': (1, 1, 0.5, 1, 1, 3), 'wheel': (3, 1, 0, 0, 0, 8)}
# Share of a run's root mean square of force beyond which errors of the load count by their length.
ROBUST = {'blade': 0.15, 'wheel': 0.3}
# Standard deviations of what is added to the inputs of the load, which are of order one: to all of
# them; and to some that say the tool, the same for all its strips. Else the networks learn by heart
# the runs of a blade, and the few tools that there are. Those of a wheel err more with the first.
NOISE = {'blade': 0.02, 'wheel': 0.0}
NOISE_OF_TOOL = {
    'blade': {
        'half_width': 0.1, 'radius': 0.05, 'length': 0.2, 'bucket': 0.2, 'plates': 0.2,
        'stress': 0.1, 'floor': 0.1, 'floor_share': 0.1,
    },
    'wheel': {'lugs': 0.1, 'lug_height': 0.1},
}  # fmt: skip
# The load of a blade is also learned of copies of the runs at other sizes (`Run.resized`), where
# the scale of the tool stays: few runs have another edge than most. A wheel's scale never does.
SIZES = (0.77, 1.3)
_STREAMS = {'load': 1, 'surface': 2, 'soil': 3}


def make_field(
    config: SoilFieldConfig, tool_name: str, hidden=None, first: SoilField | None = None
) -> SoilField:
    """A field for tools of a name, with fresh networks of some hidden layers, or those of another
    field to start from.

    Raises:
      ValueError: that field is of other tools, or of another number of members.
    """
    tool = TOOLS[tool_name]
    if first is not None:
        known = first.networks
        if (known.tool, known.members) != (tool, config.members):
            raise ValueError(
                f'the initial weights are of {known.members} members for a {known.tool.name}, '
                f'those of {config.members} for a {tool_name} were expected'
            )
        hidden = known.hidden
    networks = network.SoilNetworks(tool, config.members, config.seed, hidden)
    if first is not None:
        for variable, value in zip(networks.variables, first.networks.variables, strict=True):
            variable.assign(value)
    return SoilField(config, networks)


def parts_of(
    field: SoilField, runs: list[Run], progress=iter, copies=True, processes: int = 1
) -> dict[str, list]:
    """Name of a network -> samples of runs, joined where they have one shape: loads of uneven
    terrain have five strips, of even terrain one. The field learns their ranges. With `copies`,
    samples of copies of the runs, too. Those of more than `FEW` runs are made by some processes.

    Raises:
      ValueError: no runs.
      OSError: a process was killed.
    """
    if not runs:
        raise ValueError('no runs to learn from')
    values: list = []
    pools: dict[str, dict] = {name: {} for name in network.NETWORKS}
    sampled = _sampled(field, runs, copies, processes if len(runs) > FEW else 1)
    for _ in progress(runs):
        judged, parts = next(sampled)
        values += judged
        for name, part in parts:
            pools[name].setdefault(part.inputs[0].shape[1:], []).append(part)
    seen = np.concatenate(values)
    lows, highs = seen.min(axis=0).tolist(), seen.max(axis=0).tolist()
    for name, low, high in zip(field.judged_names, lows, highs, strict=True):
        if name not in CONDITIONS:  # no wall is as good as one far away
            field.ranges[name] = [0.0 if name.startswith('wall') else low, high]
    return {name: [_joined(some) for some in pool.values()] for name, pool in pools.items()}


def _sampled(field, runs, copies, processes):
    """`parts_of_run` of all runs, in their order."""
    if processes == 1:
        yield from (parts_of_run(field, run, copies) for run in runs)
        return
    found: dict[int, tuple] = {}
    with workers.start(processes=processes) as pool:
        inputs = [(field.networks.tool.name, run, copies) for run in runs]
        due = 0
        for outcome in pool.run(_sampled_alone, inputs):
            if outcome.error:
                raise ValueError(f'run {runs[outcome.index].case}: {outcome.error}')
            found[outcome.index] = outcome.value
            while due in found:
                yield found.pop(due)
                due += 1


def _sampled_alone(item):
    """`parts_of_run` by a process that has one core; no sample depends on what a field knows."""
    tool_name, run, copies = item
    return parts_of_run(_field_alone(tool_name), run, copies)


@functools.cache
def _field_alone(tool_name):
    command.import_tensorflow(1)
    return make_field(SoilFieldConfig('soil_field', members=1), tool_name)


def parts_of_run(field: SoilField, run: Run, copies=True) -> tuple[list, list]:
    """What is judged of a run [T, J], by episode, and the samples (name of a network, `Part`) of it
    and its copies. Its places are a draw of its name: all seeds learn from the same ones."""
    networks, values, parts = field.networks, [], []
    whole, run = run, samples.until_lifted(run)
    name = zlib.crc32(f'{run.kind} {run.case}'.encode())
    rng = np.random.Generator(np.random.Philox(key=0, counter=[0, 0, 9, name]))
    # What a wheel does forwards, it does backwards.
    mirrored = [run.mirrored()] if copies and isinstance(run.tool, Wheel) else []
    for each in [run, *mirrored]:
        motion = None
        for start, episode in samples.episodes_of(each):
            motion = samples.motion_of(episode) if motion is None else motion
            if not start or np.isfinite(run.tool.renewed_after):
                seen = field.judged(episode.frames)  # a renewed passage begins like that
                if run is not whole:  # where a bucket lifts it is faster than tools go in the soil
                    seen[:, [field.judged_names.index(name) for name in ('speed', 'along')]] = 0.0
                values.append(seen)
            parts.append(('load', samples.load_part(networks, each, episode)))
            parts.append(('surface', samples.surface_part(networks, episode, motion, rng)))
        if each.particles is not None:
            parts.append(('soil', samples.soil_part(networks, each, rng)))
    for copy in copies_of(run) if copies else ():
        for _, episode in samples.episodes_of(copy):
            parts.append(('load', samples.load_part(networks, copy, episode)))
    return values, parts


def copies_of(run: Run) -> list[Run]:
    """The run of a blade at other `SIZES`, where the scale of the tool stays; [] of other tools."""
    if not isinstance(run.tool, Blade):
        return []
    return [copy for copy in map(run.resized, SIZES) if copy.tool.scale == run.tool.scale]


def _joined(parts):
    inputs = zip(*(part.inputs for part in parts), strict=True)
    return samples.Part(
        tuple(map(np.concatenate, inputs)),
        np.concatenate([part.target for part in parts]),
        np.concatenate([part.weight for part in parts]),
    )


def fit(field: SoilField, pools: dict[str, list], progress=True, saved=None, held=None) -> dict:
    """Trains all networks on `parts_of`; returns their mean losses over the last tenth. `saved`
    keeps what was trained, see `method.Saved`.

    Where there is `held`, `parts_of` other runs, a network that is no better on them than it was
    at first gets its first weights back: a few runs of one tool can spoil what many have taught.

    Raises:
      ValueError: a loss that is not finite.
    """
    networks, config = field.networks, field.config

    def predicted(name, inputs, target):
        if name != 'load':
            return networks.moved_of(name, *inputs)
        # The shares of a wheel are learned of what it bears, not of what it seems to bear.
        return networks.load_of(*inputs, borne=target[:, 1] if networks.tool.bears else None)

    components = tf.constant(COMPONENTS[networks.tool.name], tf.float32) / network.FORCE
    losses = {}
    for name, parts in pools.items():
        if not parts:
            continue
        part, scale = getattr(networks, name), components if name == 'load' else 1 / network.LENGTH
        # ROBUST in the unit of errors: weights of a load are 1 over the mean square of a run.
        limit = (ROBUST[networks.tool.name] / network.FORCE) ** 2 if name == 'load' else 0.0
        how = functools.partial(predicted, name), scale, limit
        first = [value.numpy() for value in part.trainable_variables]
        others = held[name] if held else []
        before = loss_of(*how, others)
        noise = _noise(networks) if name == 'load' else None
        losses[f'loss_{name}'] = _fit(networks, *how, name, parts, config, noise, progress, saved)
        after = loss_of(*how, others)
        if others:
            stays = after >= before
            print(f'{name}: {after / before:.3g} of its first loss on valid runs'
                  + (', so it stays as it was' if stays else ''))  # fmt: skip
            if stays:
                for variable, value in zip(part.trainable_variables, first, strict=True):
                    variable.assign(value)
    return losses


def _noise(networks):
    """What adds noise to own inputs [B, K, I] and sides [B, K, 2, I'] of the load."""
    to_all, of_tool = NOISE[networks.tool.name], NOISE_OF_TOOL[networks.tool.name]
    operands = [row.operand for row in networks.inputs.tables.load.rows for _ in range(row.columns)]
    deviations = np.array([of_tool.get(operand, 0.0) for operand in operands], np.float32)

    def noise(rng, own, sides):
        own = own + deviations * rng.standard_normal((len(own), 1, own.shape[2]), np.float32)
        for seen in (own, sides):
            yield seen + to_all * rng.standard_normal(seen.shape, np.float32) if to_all else seen

    return noise


def loss_of(call, scale, limit: float, pools) -> float:
    """The loss (16), (17) of the mean of the members on all rows of some pools, see `_losses`; 0 of
    none."""
    total, weights = 0.0, 0.0
    for pool in pools:
        for start in range(0, len(pool.weight), ROWS):
            rows = slice(start, start + ROWS)
            found = call(tuple(x[rows] for x in pool.inputs), pool.target[rows])
            known = pool.target[rows], pool.weight[rows]
            losses = _losses(tf.reduce_mean(found, axis=0), *known, scale, limit)
            total += float(tf.reduce_sum(losses))
        weights += float(pool.weight.sum(dtype=np.float64))
    return total / weights if weights else 0.0


def _losses(found, target, weight, scale, limit: float):
    """(16), (17) [..., R]: weighted squares of the errors of what was found [..., R(, O)]; beyond
    `limit`, h^2 (0: none), as H has it."""
    error = (found - target) * scale
    square = weight * (error**2 if len(target.shape) == 1 else tf.reduce_sum(error**2, axis=-1))
    if not limit:
        return square
    far = 2.0 * tf.sqrt(limit * tf.maximum(square, limit)) - limit
    return tf.where(square < limit, square, far)


def _fit(networks, call, scale, limit, name, pools, config, noise, progress, saved=None):
    tool, variables = networks.tool.name, getattr(networks, name).trainable_variables
    batch, longer, faster = SCHEDULES[tool][name]
    num_steps = longer * config.num_steps
    schedule = tf.keras.optimizers.schedules.CosineDecay(faster * config.learning_rate, num_steps)
    optimizer = tf.keras.optimizers.Adam(schedule, global_clipnorm=CLIP_NORM)
    optimizer.build(variables)
    counts = np.array([len(pool.weight) for pool in pools])
    mean = sum(pool.weight.sum(dtype=np.float64) for pool in pools) / counts.sum()
    limit = float(limit / mean)  # of weights that are divided by the mean
    # Pools are drawn from by their shares.
    sizes = np.maximum(np.rint(batch * counts / counts.sum()), 1).astype(int)

    @tf.function(autograph=False)
    def step(drawn):
        with tf.GradientTape() as tape:
            total = 0.0
            for inputs, target, weight in drawn:
                # Summed over members, which know nothing of each other.
                total += tf.reduce_sum(_losses(call(inputs, target), target, weight, scale, limit))
            loss = total / batch
        gradient = tape.gradient(loss, variables)
        optimizer.apply_gradients(zip(gradient, variables, strict=True))
        return loss

    state = [*variables, *optimizer.variables]
    first, late = saved.restore(name, state) if saved else (0, [])
    bar = tqdm.tqdm(
        range(first, num_steps), initial=first, total=num_steps, unit='step', desc=name,
        disable=None if progress else True,
    )  # fmt: skip
    for number in bar:
        rng = np.random.Generator(
            np.random.Philox(key=config.seed, counter=[0, 0, _STREAMS[name], number])
        )
        drawn = []
        for pool, size in zip(pools, sizes, strict=True):
            rows = rng.integers(len(pool.weight), size=size)
            inputs = tuple(x[rows] for x in pool.inputs)
            if noise:
                inputs = *noise(rng, *inputs[:2]), *inputs[2:]
            weight = (pool.weight[rows] / mean).astype(np.float32)
            drawn.append((inputs, pool.target[rows], weight))
        loss = step(drawn)
        if number % 50 == 0 or number + 1 > 0.9 * num_steps:
            value = float(loss) / config.members
            if not np.isfinite(value):
                raise ValueError(f'the loss of the {name} is {value} at step {number}')
            bar.set_postfix(loss=f'{value:.3g}')
            tf.summary.scalar(f'{name}/loss', value, step=number)  # of a writer, where there is one
            if number + 1 > 0.9 * num_steps:
                late.append(value)
        if saved:
            saved.keep(name, number + 1, number + 1 == num_steps, state, late)
    return float(np.mean(late))
