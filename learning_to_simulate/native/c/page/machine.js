// The model: WebAssembly with one tool on one terrain, the tool's targets, and scripts that set them.
const DT = 1 / 60;
const turnedBy = (heading, lean) => {
  const [a, b, c, d] = [Math.cos(heading / 2), Math.sin(heading / 2), Math.cos(lean / 2), Math.sin(lean / 2)];
  return [a * c, b * d, b * c, a * d];  // about y, then about z
};
const toward = (value, target, most) => value + Math.max(-most, Math.min(most, target - value));

// What a user does about an error of lts.h.
const REFUSED = {
  [-3]: 'this browser gave too little memory; close other tabs and load the page again',
  [-5]: 'this place or this turn cannot be reached; press Reset',
  [-7]: 'the tool would jump; press Reset',
  [-8]: 'here the ground ends, or does not bear the tool; raise it, turn back, or press Reset',
};

class Machine {
  constructor(exports) { this.c = exports; this.code = 0; }

  doubles(at, n) { return new Float64Array(this.c.memory.buffer, at, n); }
  get force() { return [...this.doubles(this.c.page_force(), 3)]; }
  get torque() { return [...this.doubles(this.c.page_torque(), 3)]; }
  // About the tool's own axis across, N m.
  get pitch() { return dot(this.torque, turned(this.pose.slice(3), [0, 0, 1])); }
  get bound() { return this.c.page_bound(); }
  get payload() { return this.c.page_payload(); }
  heights() { return this.doubles(this.c.page_heights(), this.n[0] * this.n[1]); }

  // Why the newest frame is not to be relied on, in words; '' while it is.
  reason() {
    const bytes = new Uint8Array(this.c.memory.buffer, this.c.page_reason(this.code));
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }
  // The same for a user, and what to do; the name of the number stands in brackets.
  words() {
    const reason = this.reason();
    if (this.code < 0) return `Held back: ${REFUSED[this.code] || 'the model took no step; press Reset'} (${reason})`;
    const [, name, value, low, high] = reason.match(/^(\w+) (\S+) is outside (?:twice )?\[(\S+), (\S+)\] of training$/) || [];
    if (!name) return reason && `The model gives no answer here: press Reset (${reason})`;
    const [what, unitName] = config.words[name], short = (v) => `${+(+v).toPrecision(3)}`.replace('-', '−');
    return `Beyond what the model was trained on: ${what}, ${short(value)} ${unitName} (${name}; trained: ${short(low)} to ${short(high)})`;
  }
  get status() { return this.code < 0 ? 'refused' : this.c.page_status() ? 'outside' : 'ok'; }

  // tool: as `lts_soil_tool`; ground {n, corner, cell, walled, floor, soil, heights}.
  make(tool, ground) {
    Object.assign(this, { tool, n: ground.n, corner: ground.corner, cell: ground.cell, points: null });
    const soil = ground.soil || [37.2348, 1730.61, 9.81];
    this.doubles(this.c.page_numbers(), 24).set([...tool, ...ground.n, ...ground.corner, ...ground.cell, ground.walled ? 1 : 0, ground.floor, ...soil]);
    this.code = this.c.page_make();
    if (this.code >= 0 && ground.heights) this.heights().set(ground.heights);
    return this.code >= 0;
  }

  start(pose) {
    this.send(pose);
    this.pose = this.planned = [...pose];
    this.code = this.c.page_start();
    this.anchored = null;
    return this.code >= 0;
  }

  send(pose) { this.doubles(this.c.page_pose(), 7).set(pose); }

  // To a pose within dt s; at the height of a weight (N) where one is given. A refused pose changes nothing.
  step(pose, dt, weight) {
    if (!weight) this.turnInAir(pose);
    this.send(pose);
    this.code = weight ? this.c.page_sink(weight, dt) : this.c.page_step(dt);
    if (this.code < 0) return false;
    this.pose = [...pose];
    this.pose[1] = this.doubles(this.c.page_place(), 3)[1];
    if (this.anchored) {
      if (this.leaves()) this.regrow();
      else this.c.page_follow(dt);
    }
    return true;
  }

  // In the air the tool goes where it likes: it is set down anew where it turns or moves aside.
  turnInAir(pose) {
    const along = turned(this.planned.slice(3), [0, 0, 1]), now = turned(pose.slice(3), [0, 0, 1]), way = add(pose.slice(0, 3), this.planned.slice(0, 3), -1);
    const isAside = Math.abs(dot(way, unit([along[0], 0, along[2]]))) > 1e-4 || dot(unit(along), unit(now)) < 1 - 1e-8;
    if (!isAside) return;
    const low = this.pose[1] - this.tool[1] - this.tool[8], half = this.tool[0] / 2;
    for (let a = -1; a <= 1; a += 0.25) for (let b = -1; b <= 1; b += 0.25) {
      const side = turned(this.pose.slice(3), [0, 0, a * half]), x = this.pose[0] + side[0] + b * this.tool[1], z = this.pose[2] + side[2];
      if (this.level(x, z) > low - 0.01) return;
    }
    this.start(this.pose);
  }

  // Cells that may have changed: [low, high) along both axes.
  changed() {
    this.c.page_update();
    const [x, z, r] = this.doubles(this.c.page_sight(), 3), low = [], high = [];
    [x, z].forEach((v, i) => {
      low.push(Math.max(0, Math.floor((v - r - this.corner[i]) / this.cell[i])));
      high.push(Math.min(this.n[i], Math.ceil((v + r - this.corner[i]) / this.cell[i]) + 1));
    });
    return [low, high];
  }

  level(x, z) {
    const i = Math.floor((x - this.corner[0]) / this.cell[0]), j = Math.floor((z - this.corner[1]) / this.cell[1]);
    return i < 0 || j < 0 || i >= this.n[0] || j >= this.n[1] ? 0 : this.heights()[i * this.n[1] + j];
  }

  // Grains stand on a lattice about the tool and follow it until it has gone 0.25 m; then all begins anew.
  leaves() { return Math.hypot(this.pose[0] - this.anchored[0], this.pose[2] - this.anchored[2]) > 0.25 * this.scale(); }
  scale() { return config.kind === 'wheel' ? this.tool[1] / 0.1 : Math.min(1, Math.max(this.tool[0] / 0.6, 1)); }

  regrow() {
    const s = this.scale(), [x, , z] = this.pose, q = this.pose.slice(3), spacing = 0.013 * s, found = [], width = this.tool[0] / 2 + 0.06 * s;
    const ahead = turned(q, [-1, 0, 0]), flat = unit([ahead[0], 0, ahead[2]]), side = [-flat[2], 0, flat[0]];
    for (let a = -0.1 * s; a < 0.42 * s; a += spacing) for (let b = -width; b <= width; b += spacing) {
      const px = x + a * flat[0] + b * side[0] + spacing * (Math.random() - 0.5), pz = z + a * flat[2] + b * side[2] + spacing * (Math.random() - 0.5);
      found.push(px, this.level(px, pz) - 0.2 * spacing, pz);
    }
    if (this.points) { this.c.page_free(this.points.rest); this.c.page_free(this.points.now); }
    const n = found.length / 3;
    this.points = { n, rest: this.c.page_points(n), now: this.c.page_points(n), data: new Float32Array(4 * n), size: 0.8 * spacing };
    this.doubles(this.points.rest, 3 * n).set(found);
    this.c.page_anchor();
    this.anchored = [...this.pose];
  }

  // {data [n][x, y, z, share of 30 mm], count, size}, of grains that have moved.
  grains() {
    if (!this.anchored) this.regrow();
    const { n, rest, now, data, size } = this.points;
    if (this.c.page_displace(rest, n, now) < 0) return null;
    const a = this.doubles(rest, 3 * n), b = this.doubles(now, 3 * n);
    const far = 0.03 * this.scale();
    let count = 0;
    for (let k = 0; k < 3 * n; k += 3) {
      const moved = Math.hypot(b[k] - a[k], b[k + 1] - a[k + 1], b[k + 2] - a[k + 2]);
      if (moved < 1e-3) continue;
      const at = 4 * count++;
      data[at] = b[k]; data[at + 1] = b[k + 1]; data[at + 2] = b[k + 2]; data[at + 3] = moved / far;
    }
    return { data, count, size };
  }
}

// What a tool is told: targets, and a state that follows them at the speed of a machine.
class Driver {
  constructor(kind, tool) {
    this.kind = kind; this.tool = tool;
    const r = tool[1], isWheel = kind === 'wheel';
    this.target = { speed: 0, turn: 0, depth: -0.02, lean: 0, slip: isWheel ? 0.15 : 0, load: isWheel ? 120 : 300, sideways: 0 };
    this.state = { x: 0, y: r + 0.02, z: 0, heading: 0, lean: 0, speed: 0 };
  }
  get limits() {
    return this.kind === 'wheel'
      ? { speed: [-0.1, 0.1, 'm/s', 2], slip: [0, 0.7, '', 2], load: [20, 200, 'N', 0], turn: [-0.3, 0.3, 'rad/s', 2], depth: [-0.05, 0.05, 'm', 3] }
      : { speed: [-0.3, 0.3, 'm/s', 2], depth: [-0.2, 0.09, 'm', 3], lean: [-0.6, 0.85, 'rad', 2], turn: [-0.4, 0.4, 'rad/s', 2], load: [50, 1500, 'N', 0] };
  }

  // The state after dt s, [the pose, the state]; nothing is kept until `take`.
  next(dt) {
    const t = this.target, s = { ...this.state };
    s.speed = toward(s.speed, t.speed, 0.6 * dt);
    s.heading += t.turn * dt;
    const go = s.speed * dt, [c, n] = [Math.cos(s.heading), Math.sin(s.heading)];
    s.x -= go * c; s.z += go * n + t.sideways * dt;
    s.y = toward(s.y, this.tool[1] - t.depth, 0.08 * dt);
    if (this.kind === 'wheel') {
      // A wheel that spins turns faster than it goes; one that stands and is told to slip turns all the same.
      const slip = Math.min(t.slip, 0.9);
      s.lean += go / (this.tool[1] * (1 - slip));
    } else {
      s.lean = toward(s.lean, t.lean, 0.7 * dt);
    }
    return [[s.x, s.y, s.z, ...turnedBy(s.heading, s.lean)], s];
  }
  take(state, pose) { this.state = { ...state, y: pose[1] }; }
}

// Presets: pieces [seconds or a condition on the driver, targets].
const BLADE_PRESETS = {
  'Slice': [[1, { depth: 0.005 }], [2.2, { depth: 0.03, speed: 0.12 }], [4, { speed: 0.12 }], [1.2, { speed: 0.04, depth: -0.04 }], [1, { speed: 0 }]],
  'Trench': [[1, { depth: 0.01 }], [1, { speed: 0.12, depth: 0.012 }], [(d) => d.state.x < -2.8, { speed: 0.2 }], [2, { speed: 0.06, depth: -0.06 }], [1, { speed: 0 }]],
  'Cut beside': [[1, { depth: 0.005 }], [1.5, { speed: 0.15, depth: 0.035 }], [(d) => d.state.x < -0.8, { speed: 0.2 }], [3, { speed: 0.02, depth: -0.16 }],
    [(d) => d.state.x > -0.05, { speed: -0.3, sideways: 0.13 }], [1, { speed: 0, sideways: 0 }], [2.6, { depth: 0.005 }], [1.5, { speed: 0.15, depth: 0.035 }],
    [(d) => d.state.x < -0.8, { speed: 0.2 }], [3, { speed: 0.02, depth: -0.16 }], [1, { speed: 0 }]],
  'Press and hold': [[1, { depth: 0.0 }], [1.5, { depth: 0.035 }], [6, {}]],
};
const WHEEL_PRESETS = {
  'Drive under load': [[1, { speed: 0 }], [14, { speed: 0.05, slip: 0.1 }], [1, { speed: 0 }]],
  'Spin with slip': [[1, { speed: 0 }], [3, { speed: 0.03, slip: 0.2 }], [10, { speed: 0.02, slip: 0.6 }], [1, { speed: 0 }]],
};

class Script {
  constructor(pieces) { this.pieces = pieces; this.piece = -1; this.time = 0; }
  // Sets the targets of a driver for the coming dt s; false at the end.
  advance(driver, dt) {
    const until = this.piece < 0 ? 0 : this.pieces[this.piece][0];
    this.time += dt;
    if (typeof until === 'function' ? until(driver) : this.time > until) {
      if (++this.piece >= this.pieces.length) return false;
      this.time = 0;
      Object.assign(driver.target, this.pieces[this.piece][1]);
    }
    return true;
  }
}
