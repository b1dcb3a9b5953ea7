// The page: controls, the loop, what is shown.
const $ = (id) => document.getElementById(id);
const isWheel = config.kind === 'wheel';
const TOOLS = isWheel
  ? { 'Wheel with grousers': [0.125, 0.15, 0, 0, 0, 0, 0, 16, 0.012], 'Smooth wheel': [0.125, 0.15, 0, 0, 0, 0, 0, 0, 0] }
  : { Blade: config.tool, Bucket: [0.426, 0.004, 0.353, 1, 1, 8.7, 0.62, 0, 0] };
const PRESETS = isWheel ? WHEEL_PRESETS : BLADE_PRESETS;
const CELL = 0.02, REACH = isWheel ? 6 * 0.15 : 1.4;  // m: of the terrain; of what is seen of it
const RANGE = isWheel ? 0.016 : 0.04;  // m of the last colour
const SHOWN_EVERY = 150;  // ms: figures and chart; to paint them takes as long as the scene
const NEWTONS = isWheel ? 500 : 2000;  // of an arrow of one metre

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'))).arrayBuffer();
}

class Page {
  constructor(exports, scene) {
    this.machine = new Machine(exports); this.scene = scene;
    this.toolName = Object.keys(TOOLS)[0]; this.preset = ''; this.script = null; this.ghost = null;
    this.paused = false; this.keys = new Set(); this.times = []; this.said = ''; this.recording = null; this.frame = 0; this.shown = -Infinity;
    $('loaded').checked = isWheel;
    if (isWheel) scene.azimuth = -0.8;  // from behind: the rut lies in front
    this.buttons(); this.sliders(); this.steering(); this.legend();
    this.reset();
  }

  // --- What is on the terrain
  flat() {
    const cell = [CELL, CELL], size = isWheel ? [12, 4] : [18, 6];
    return { n: size.map((v, i) => Math.round(v / cell[i])), cell, corner: [isWheel ? -10 : -15, -size[1] / 2], walled: false, floor: -1 };
  }

  reset() {
    const ghost = this.ghost, numbers = ghost ? ghost.tool : TOOLS[this.toolName], spec = ghost || this.flat();
    this.driver = new Driver(config.kind, numbers);
    this.frame = 0; this.rows = []; this.said = ''; this.grains = null; this.trouble = ''; this.looked = -Infinity; this.looking = 0;
    const pose = ghost ? ghost.pose[0] : this.driver.next(1e-9)[0];
    if (!this.machine.make(numbers, spec) || !this.machine.start(pose)) this.trouble = `The tool cannot start here. ${this.machine.words()}`;
    for (const ground of this.grounds || []) if (ground.scene === this.scene) this.scene.gl.deleteTexture(ground.texture);
    this.grounds = [new Ground(this.scene, spec.n, spec.corner, spec.cell, this.machine.heights())];
    if (ghost) this.grounds.push(new Ground(this.scene, spec.n, spec.corner, spec.cell, spec.heights, [0, 0, 1.12 * spec.n[1] * spec.cell[1]]));
    for (const id of ['pad', 'lift', 'sliders']) $(id).hidden = !!ghost;
    for (const id of ['loaded', 'particles']) $(id).parentElement.hidden = !!ghost;
    this.scene.setTool(config.kind, numbers);
    this.reach = ghost && isWheel ? 6 * numbers[1] : REACH;
    this.scene.distance = ghost ? 2.3 * spec.n[0] * spec.cell[0] : this.reach * 1.45;
    this.scene.focus = this.middle(pose);
    if (this.preset && !ghost) this.script = new Script(PRESETS[this.preset]);
    this.show();
  }

  middle(pose) {
    if (this.ghost) { const g = this.ghost; return [g.corner[0] + g.n[0] * g.cell[0] / 2, g.heights[0], g.corner[1] + 1.05 * g.n[1] * g.cell[1]]; }
    return [pose[0] - (isWheel ? 0 : 0.12), isWheel ? 0.2 * this.driver.tool[1] : 0.06, pose[2]];
  }

  play(name) {
    this.preset = name;
    this.ghost = name === 'Beside the solver' ? config.ghost : null;
    if (name && !isWheel && $('loaded').checked) $('loaded').checked = false;
    this.script = null;
    this.reset();
    this.pause(false);
    for (const b of $('presets').querySelectorAll('button')) b.classList.toggle('on', b.textContent === name);
  }

  pause(value) { this.paused = value; $('pause').textContent = value ? 'Go on' : 'Pause'; }

  free() { this.preset = this.preset && ''; this.script = null; for (const b of $('presets').querySelectorAll('button')) b.classList.remove('on'); }

  // --- One step of the model
  advance(dt) {
    if (this.trouble) return;
    const m = this.machine;
    if (this.ghost) {
      if (this.frame + 1 >= this.ghost.pose.length) { this.said = 'The recorded run is over'; return; }
      if (!m.step(this.ghost.pose[this.frame + 1], this.ghost.dt)) return;
      this.frame++;
    } else {
      this.held();
      if (this.script && !this.script.advance(this.driver, dt)) { this.script = null; this.driver.target.speed = 0; this.said = 'The preset is over: steer it yourself, or play it again'; }
      const [pose, state] = this.driver.next(dt), weight = $('loaded').checked ? this.driver.target.load : 0;
      if (weight) pose[1] = m.pose[1];
      if (!m.step(pose, dt, weight)) { this.driver.target.speed = 0; this.driver.state.speed = 0; return; }
      this.driver.take(state, m.pose);
      this.frame++;
    }
    const t = this.frame * dt, f = m.force, [ahead, side] = this.axes(), split = (v) => [-(v[0] * ahead[0] + v[2] * ahead[2]), v[1], v[0] * side[0] + v[2] * side[2]];
    const row = { t, force: split(f), bound: m.bound, ghost: this.ghost ? split(this.ghost.force[this.frame]) : null };
    this.rows.push(row);
    if (this.rows.length > SECONDS / dt + 2) this.rows.shift();
    if (this.recording) {
      this.recording.push([t.toFixed(4), ...m.pose, ...f, ...m.torque, m.bound, m.status, `"${m.reason().replaceAll('"', "'")}"`].join(','));
    }
  }

  axes() {
    const v = turned(this.machine.pose.slice(3), [0, 0, 1]), side = unit([v[0], 0, v[2]]);
    return [[-side[2], 0, side[0]], side];
  }

  // --- Controls
  buttons() {
    const row = $('presets');
    const select = document.createElement('select');
    select.setAttribute('aria-label', 'Tool');
    for (const name of Object.keys(TOOLS)) select.append(new Option(name));
    select.onchange = () => { this.toolName = select.value; this.play(this.ghost ? '' : this.preset); };
    row.append(select);
    for (const name of [...Object.keys(PRESETS), ...(config.ghost ? ['Beside the solver'] : [])]) {
      const button = document.createElement('button');
      button.textContent = name; button.onclick = () => this.play(name);
      row.append(button);
    }
    $('about').textContent = `Model ${config.model}, ${config.digest}. It runs in this page.`;
    $('pause').onclick = () => this.pause(!this.paused);
    $('reset').onclick = () => this.reset();
    $('loaded').onchange = () => { this.driver.state.speed = 0; };
    $('record').onclick = () => {
      if (this.recording && $('record').classList.contains('on')) { this.kept = this.recording; this.recording = null; } else {
        this.recording = ['t_s,x_m,y_m,z_m,qw,qx,qy,qz,fx_N,fy_N,fz_N,tx_Nm,ty_Nm,tz_Nm,bound_N,status,reason'];
      }
      $('record').classList.toggle('on', !!this.recording);
      $('record').textContent = this.recording ? 'Stop' : 'Record';
      $('download').disabled = !(this.kept && this.kept.length > 1);
    };
    $('download').onclick = () => {
      const link = document.createElement('a');
      link.href = URL.createObjectURL(new Blob([this.csv()], { type: 'text/csv' }));
      link.download = `${config.kind}.csv`; link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    };
  }
  csv() { return `${(this.kept || []).join('\n')}\n`; }

  sliders() {
    this.fields = {};
    const driver = new Driver(config.kind, Object.values(TOOLS)[0]);
    for (const [name, [low, high, unitName, digits]] of Object.entries(driver.limits)) {
      const label = document.createElement('label'), input = document.createElement('input'), out = document.createElement('output');
      Object.assign(input, { type: 'range', min: low, max: high, step: (high - low) / 200 });
      const milli = unitName === 'm';
      label.append(name[0].toUpperCase() + name.slice(1), input, out);
      input.oninput = () => { this.free(); this.driver.target[name] = +input.value; };
      this.fields[name] = (v) => {
        if (document.activeElement !== input || Math.abs(+input.value - v) > 1e-9) input.value = v;
        const text = unitName === '' ? `${(100 * v).toFixed(0)} %` : milli ? `${(1000 * v).toFixed(0)} mm` : `${v.toFixed(digits)} ${unitName}`;
        if (out.value !== text) out.value = text;
      };
      $('sliders').append(label);
    }
  }

  // Keys and pads that are held change targets.
  held() {
    const k = this.keys, t = this.driver.target, l = this.driver.limits, on = (...names) => names.some((n) => k.has(n));
    const clip = (name) => { if (l[name]) t[name] = Math.max(l[name][0], Math.min(l[name][1], t[name])); };
    if (this.pushed) { t.speed = this.pushed[1] * 0.8 * l.speed[1]; t.turn = this.pushed[0] * l.turn[0]; }
    if (on('w', 'arrowup')) t.speed += l.speed[1] / 60; else if (on('s', 'arrowdown')) t.speed -= l.speed[1] / 60;
    if (on('a', 'arrowleft')) t.turn = l.turn[1] / 2; else if (on('d', 'arrowright')) t.turn = l.turn[0] / 2; else if (this.wasTurning) t.turn = 0;
    this.wasTurning = on('a', 'd', 'arrowleft', 'arrowright');
    if (on('r')) t.depth -= 0.0008; if (on('f')) t.depth += 0.0008;
    if (on('q')) t.lean -= 0.008; if (on('e')) t.lean += 0.008;
    ['speed', 'turn', 'depth', 'lean'].forEach(clip);
  }

  steering() {
    addEventListener('keydown', (e) => {
      if (e.target.matches('input,select') || e.ctrlKey || e.metaKey) return;
      const key = e.key.toLowerCase();
      if (key === ' ') { e.preventDefault(); this.pause(!this.paused); } else if (key === '0') this.reset(); else if (/^([wasdrfqe]|arrow\w+)$/.test(key)) {
        e.preventDefault(); this.free(); this.keys.add(key);
      }
    });
    addEventListener('keyup', (e) => this.keys.delete(e.key.toLowerCase()));
    addEventListener('blur', () => this.keys.clear());
    const pad = $('pad'), knob = pad.firstElementChild;
    const push = (e) => {
      const box = pad.getBoundingClientRect(), r = box.width / 2, at = [(e.clientX - box.left) / r - 1, 1 - (e.clientY - box.top) / r];
      const n = Math.max(1, Math.hypot(...at)); this.pushed = at.map((v) => v / n);
      knob.style.transform = `translate(${0.6 * r * this.pushed[0]}px,${-0.6 * r * this.pushed[1]}px)`;
    };
    pad.onpointerdown = (e) => { pad.setPointerCapture(e.pointerId); this.free(); push(e); };
    pad.onpointermove = (e) => { if (this.pushed) push(e); };
    pad.onpointerup = pad.onpointercancel = () => { this.pushed = null; knob.style.transform = ''; this.driver.target.speed = 0; this.driver.target.turn = 0; };
    [...$('lift').children].forEach((button, i) => {
      const key = 'rf'[i];
      button.onpointerdown = (e) => { button.setPointerCapture(e.pointerId); this.free(); this.keys.add(key); };
      button.onpointerup = button.onpointercancel = () => this.keys.delete(key);
    });
    const canvas = this.scene.canvas, fingers = new Map();
    canvas.onpointerdown = (e) => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); };
    canvas.onpointerup = canvas.onpointercancel = (e) => fingers.delete(e.pointerId);
    canvas.onpointermove = (e) => {
      if (!fingers.has(e.pointerId)) return;
      const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const last = fingers.get(e.pointerId), before = fingers.size > 1 ? spread() : 0;
      fingers.set(e.pointerId, [e.clientX, e.clientY]);
      if (fingers.size > 1) { this.zoom(before / Math.max(spread(), 1)); return; }
      this.scene.azimuth -= (e.clientX - last[0]) / 200;
      this.scene.height = Math.max(0.06, Math.min(1.5, this.scene.height + (e.clientY - last[1]) / 250));
    };
    canvas.addEventListener('webglcontextlost', (e) => { e.preventDefault(); this.said = 'The graphics card is away: the picture comes back with it'; });
    canvas.addEventListener('webglcontextrestored', () => this.revive());
    canvas.onwheel = (e) => { e.preventDefault(); this.zoom(Math.exp(e.deltaY / 900)); };
  }
  zoom(by) { this.scene.distance = Math.max(0.3 * this.reach, Math.min(3 * this.reach, this.scene.distance * by)); }

  legend() {
    const c = $('legend').querySelector('canvas').getContext('2d');
    const sand = [198, 170, 128], mix = (a, b, t) => `rgb(${a.map((v, i) => Math.round(v + t * (b[i] - v)))})`;
    for (let x = 0; x < 256; x++) {
      const t = x / 127.5 - 1, u = Math.max(0, Math.min(1, (Math.abs(t) - 0.02) / 0.73)), amount = 0.72 * u * u * (3 - 2 * u);
      c.fillStyle = mix(sand, t < 0 ? [51, 110, 143] : [184, 97, 46], amount);
      c.fillRect(x, 0, 1, 1);
    }
    const end = Math.round(1000 * RANGE);
    for (const text of [`cut −${end}`, `−${end / 2}`, '0', `+${end / 2}`, `heap +${end}`]) $('legend').querySelector('div').append(Object.assign(document.createElement('span'), { textContent: text }));
    $('keys').innerHTML = CURVES.map(([name, colour]) => `<span><i style="color:${colour}"></i>${name}</span>`).join('') +
      (config.ghost ? '<span class="solver" hidden><i style="border-top-style:dashed"></i>solver</span>' : '') + '<span class="bound" hidden>band: error bound</span>';
    $('figures').innerHTML = '<div><span>Force</span><b></b> <em>N</em></div><div><span>Pitch torque</span><b></b> <em>N m</em></div><div><span>Bound</span><b></b> <em>N</em></div>';
  }

  // --- What is shown
  show() {
    const m = this.machine, status = this.trouble ? 'refused' : m.status;
    const text = this.trouble || m.words() || this.said || 'Within what the model was trained on';
    $('status').className = { ok: 'ok', outside: 'out', refused: 'bad' }[status];
    const words = $('status').lastElementChild;
    if (words.textContent !== text) words.textContent = text;
    const numbers = [Math.hypot(...m.force), m.pitch, m.bound];
    $('figures').querySelectorAll('b').forEach((b, i) => { b.textContent = isFinite(numbers[i]) ? numbers[i].toFixed(i === 1 ? 1 : 0) : '–'; });
    const solver = $('keys').querySelector('.solver');
    if (solver) solver.hidden = !this.ghost;
    $('keys').querySelector('.bound').hidden = !isFinite(m.bound);
    $('names').textContent = this.ghost ? `back: model · front: solver, run ${this.ghost.name}` : '';
    const target = this.driver.target;
    for (const name in this.fields) this.fields[name](target[name]);
    const first = this.frame - this.rows.length + 1;  // every third frame: two pixels apart
    drawPlot($('plot'), this.rows.filter((_, i) => (first + i) % 3 === 0));
    if (!this.scene.metre) return;
    const options = [0.02, 0.05, 0.1, 0.2, 0.5, 1], long = options.filter((v) => v * this.scene.metre < 120).pop() || 0.02;
    $('scale').firstElementChild.style.width = `${Math.round(long * this.scene.metre)}px`;
    $('scale').lastElementChild.textContent = long < 1 ? `${100 * long} cm` : `${long} m`;
  }

  draw() {
    const m = this.machine, g = this.grounds[0], start = performance.now();
    // To ask the model for the ground costs more than a step: at most a quarter of the time.
    if (start - this.looked >= 3 * this.looking) {
      g.write(m.heights(), ...m.changed());
      this.grains = $('particles').checked && !this.ghost && !this.trouble ? m.grains() : null;
      this.looked = performance.now();
      this.looking = this.looked - start;
    }
    const tools = [{ pose: m.pose }];
    if (this.ghost) {
      const ground = this.grounds[1], k = Math.min(Math.floor(this.frame / this.ghost.stride), this.ghost.maps.length - 1);
      if (this.shownMap !== k) { ground.write(this.ghost.maps[k], [0, 0], g.n); this.shownMap = k; }
      const pose = [...this.ghost.pose[this.frame]]; pose[2] += ground.shift[2];
      tools.push({ pose });
    }
    const aim = this.middle(m.pose), f = this.scene.focus;
    this.scene.focus = f.map((v, i) => v + 0.12 * (aim[i] - v));
    const force = m.force, size = Math.hypot(...force), from = add(m.pose.slice(0, 3), [0, 1, 0], isWheel ? -0.9 * this.driver.tool[1] : 0.02);
    const arrow = size > 1e-3 * NEWTONS ? { from, to: add(from, force, Math.min(1 / NEWTONS, 0.6 * this.reach / size)), thick: 0.35 * this.reach } : null;
    this.scene.setPayload(m.payload);
    this.scene.draw(this.grounds, tools, arrow, this.grains, RANGE, this.ghost ? 3 : this.reach);
  }

  // Frames come as the screen asks; the model keeps to the clock, at most two steps behind.
  turn(now) {
    const gone = now - (this.before || now);
    this.before = now;
    this.late = Math.min((this.late || 0) + gone / 1000, 2.5 * DT);
    if (this.paused) this.late = 0;
    while (this.late >= DT * 0.98) { this.late -= DT; this.advance(DT); }
    this.draw();
    if (gone > 0) this.times.push(gone);
    if (this.times.length > 240) this.times.shift();
    if (now - this.shown < SHOWN_EVERY && !this.paused) return;
    this.shown = now;
    this.show();
    if (this.times.length > 30) this.pace();
  }

  // After an error in a frame the soil is laid out anew; only where that does not help, the user has to act.
  mend(error, now) {
    console.error(error);
    const again = now - (this.mended ?? -Infinity) < 3000;
    this.mended = now;
    try {
      if (again) throw error;
      $('particles').checked = false;
      this.free(); this.reset();
      this.said = 'A frame could not be computed, so the soil was laid out anew. Go on; if this comes back, load the page again';
    } catch {
      this.trouble = 'The page cannot go on: load it again';
      complain(this.trouble);
    }
  }

  // The graphics card may be taken away (sleep, a new driver): all is drawn anew when it is back.
  revive() {
    const { canvas, inView, azimuth, height } = this.scene;
    this.scene = Object.assign(new Scene(canvas, inView), { azimuth, height });
    this.reset();
    this.said = 'The graphics card was away for a moment, so the soil was laid out anew';
  }

  // Shows the frame times, and draws fewer pixels where the machine is slow.
  pace() {
    const t = this.frameTimes();
    $('rate').textContent = `${(1000 / t.median).toFixed(0)} frames/s · ${t.median.toFixed(1)} ms, 99 %: ${t.high.toFixed(0)} ms`;
    if (this.times.length < 90 || performance.now() - (this.tuned || 0) < 1500) return;
    const quality = this.scene.quality;
    this.tuned = performance.now();
    if (t.median > 19) this.scene.quality = Math.max(0.4, 0.8 * quality);
    else if (t.median < 17.2 && t.high < 20 && quality < 1) this.scene.quality = Math.min(1, 1.1 * quality);
    if (this.scene.quality !== quality) this.times = [];
  }

  // ms: median and 99 % of the last frames.
  frameTimes() {
    const sorted = [...this.times].sort((a, b) => a - b), n = sorted.length;
    return { median: sorted[Math.floor(0.5 * n)], high: sorted[Math.floor(0.99 * n)] };
  }
}

function complain(text) {
  $('status').className = 'bad';
  $('status').lastElementChild.textContent = text;
}

async function begin() {
  if (config.ghost) {
    const g = config.ghost, size = g.n[0] * g.n[1];
    g.heights = Float64Array.from(new Int32Array(await unpacked(g.bed)), (v) => v * 1e-5);
    const steps = new Int16Array(await unpacked(g.heightSteps)), sum = new Int32Array(size);
    g.maps = [];
    for (let k = 0; k < steps.length / size; k++) {
      for (let i = 0; i < size; i++) sum[i] += steps[k * size + i];
      g.maps.push(Float32Array.from(sum, (v, i) => g.heights[i] + v * 1e-4));
    }
    g.walled = true; g.floor = -1000;
  }
  const { instance } = await WebAssembly.instantiate(await unpacked(packed), {});
  const page = new Page(instance.exports, new Scene($('scene'), REACH / CELL));
  window.page = page;
  const loop = (now) => {
    try { page.turn(now); } catch (error) { page.mend(error, now); }
    requestAnimationFrame(loop);
  };
  requestAnimationFrame(loop);
  page.play(Object.keys(PRESETS)[0]);
}
begin().catch((error) => complain(`This browser cannot run the page, or its graphics are switched off. It needs WebGL 2 and WebAssembly
  with SIMD: Chrome or Edge from 2021, Firefox from 113, Safari from 16.4 have them (${error.message})`));
