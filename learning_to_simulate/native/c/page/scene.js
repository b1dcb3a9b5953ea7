// The scene by WebGL 2: height meshes lit by a low sun, a tool that throws a shadow, grains, an arrow.
const SUN = [-0.50, 0.56, -0.66];  // towards it; shadows fall to +z
const PAPER = [0.914, 0.894, 0.855];
const SHADOW = 512;

const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((v) => v / n); };
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function turned(q, v) {
  const t = cross(q.slice(1), v).map((x) => 2 * x), more = cross(q.slice(1), t);
  return v.map((x, i) => x + q[0] * t[i] + more[i]);
}

// Matrices by columns, as WebGL reads them.
function product(a, b) {
  const m = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) m[4 * c + r] += a[4 * k + r] * b[4 * c + k];
  return m;
}

function lookFrom(eye, at) {
  const back = unit(add(eye, at, -1)), side = unit(cross([0, 1, 0], back)), up = cross(back, side);
  const axes = [side, up, back], m = new Float32Array(16);
  axes.forEach((axis, r) => { for (let c = 0; c < 3; c++) m[4 * c + r] = axis[c]; m[12 + r] = -dot(axis, eye); });
  m[15] = 1;
  return m;
}

function placed(position, q, size = [1, 1, 1]) {
  const m = new Float32Array(16);
  for (let c = 0; c < 3; c++) {
    const axis = [0, 0, 0]; axis[c] = size[c];
    m.set(turned(q, axis), 4 * c);
  }
  m.set(position, 12); m[15] = 1;
  return m;
}

// Solids: triangles with normals and a colour.
class Solid {
  constructor() { this.data = []; }
  face(points, colour, normals) {
    const flat = unit(cross(add(points[1], points[0], -1), add(points[2], points[0], -1)));
    for (let k = 2; k < points.length; k++) {
      for (const i of [0, k - 1, k]) this.data.push(...points[i], ...(normals ? normals[i] : flat), ...colour);
    }
  }
  // A prism: an outline [x, y] (counterclockwise) drawn out across from z0 to z1.
  prism(outline, z0, z1, colour) {
    const n = outline.length, at = (k, z) => [...outline[k % n], z];
    for (let k = 0; k < n; k++) this.face([at(k, z0), at(k + 1, z0), at(k + 1, z1), at(k, z1)], colour);
    this.face(outline.map((_, k) => at(k, z1)), colour);
    this.face(outline.map((_, k) => at(n - 1 - k, z0)), colour);
  }
  box(low, high, colour) {
    this.prism([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]], low[2], high[2], colour);
  }
  // A ring about z between two radii.
  ring(inner, outer, z0, z1, colour, sides = 48) {
    const p = (r, k, z) => [r * Math.cos(2 * Math.PI * k / sides), r * Math.sin(2 * Math.PI * k / sides), z];
    for (let k = 0; k < sides; k++) {
      const out = [p(1, k, 0), p(1, k + 1, 0), p(1, k + 1, 0), p(1, k, 0)], into = out.map((v) => v.map((x) => -x));
      this.face([p(outer, k, z0), p(outer, k + 1, z0), p(outer, k + 1, z1), p(outer, k, z1)], colour, out);
      if (inner) this.face([p(inner, k, z1), p(inner, k + 1, z1), p(inner, k + 1, z0), p(inner, k, z0)], colour, [into[0], into[1], into[1], into[0]]);
      for (const [z, s] of [[z1, 1], [z0, -1]]) {
        const quad = [p(inner, k, z), p(outer, k, z), p(outer, k + 1, z), p(inner, k + 1, z)];
        this.face(s > 0 ? quad : quad.reverse(), colour);
      }
    }
  }
}

// A bucket of a height, and of a rise and a share of its underside: outside and inside, from the lip backwards and up.
function bucketOutline([, radius, length, , , riseDeg, share]) {
  const shell = 0.024, floor = Math.sqrt(Math.max((share * length) ** 2 - shell ** 2, 0));
  const slope = riseDeg * Math.PI / 180 + Math.atan2(shell, floor), s = Math.sin(slope), c = Math.cos(slope);
  const back = Math.max(length - shell - floor * s, 0) / (1 + c), outer = [[0, -radius]], inner = [[-0.3 * shell * s, 0.3 * shell * c - radius]];
  for (let k = 0; k < 8; k++) {
    const turn = slope - Math.PI / 2 + k / 7 * 165 / 180 * Math.PI;
    for (const [ring, r] of [[outer, back + shell], [inner, back]]) ring.push([floor * c - back * s + r * Math.cos(turn), floor * s + back * c + r * Math.sin(turn) - radius]);
  }
  return [outer, inner];
}

// Soil of a volume in a bucket, in its own axes: on its floor, below a line from the lip to the back.
function payloadSolid(numbers, volume) {
  const solid = new Solid(), width = numbers[0], low = bucketOutline(numbers)[1].slice(0, 6), end = low[5];
  const top = low.map(([x]) => low[0][1] + (x - low[0][0]) / (end[0] - low[0][0]) * (end[1] - low[0][1]));
  let area = 0;
  for (let k = 0; k < 5; k++) area += (low[k + 1][0] - low[k][0]) * (top[k] + top[k + 1] - low[k][1] - low[k + 1][1]) / 2;
  const full = Math.min(1, volume / (width * area));
  const over = low.map(([x, y], k) => [x, y + full * (top[k] - y)]);
  for (let k = 0; k < 5; k++) solid.prism([low[k], low[k + 1], over[k + 1], over[k]], -0.49 * width, 0.49 * width, [0.74, 0.62, 0.46]);
  return solid;
}

// A tool [width, radius, length, bucket, plates, rise and share of the floor, lugs, lug height] in its own axes: it looks along -x.
function toolSolid(kind, numbers) {
  const [width, radius, length, bucket, plates, , , lugs, lug] = numbers;
  const solid = new Solid(), steel = [0.55, 0.57, 0.6], dark = [0.25, 0.26, 0.28], paint = [0.84, 0.55, 0.16], half = width / 2;
  if (kind === 'wheel') {
    solid.ring(radius * 0.86, radius, -half, half, steel);
    solid.ring(0, radius * 0.2, -half * 1.12, half * 1.12, dark, 24);
    solid.ring(radius * 0.2, radius * 0.86, -half * 0.12, half * 0.12, paint);
    const n = Math.round(lugs), thick = radius * 0.045;
    const bars = n || 8;  // a smooth rim has marks, so that its turning is seen
    for (let k = 0; k < bars; k++) {
      const a = 2 * Math.PI * k / bars, c = Math.cos(a), s = Math.sin(a);
      const [r0, r1, w] = n ? [radius * 0.95, radius + lug, half] : [radius * 0.98, radius * 1.003, half * 1.003];
      solid.prism([[r0, -thick], [r1, -thick], [r1, thick], [r0, thick]].map(([x, y]) => [x * c - y * s, x * s + y * c]), -w, w, n ? dark : paint);
      if (k % 2 === 0) solid.prism([[radius * 0.15, -2 * thick], [radius * 0.9, -2 * thick], [radius * 0.9, 2 * thick], [radius * 0.15, 2 * thick]]
        .map(([x, y]) => [x * c - y * s, x * s + y * c]), -half * 0.3, half * 0.3, dark);
    }
    return solid;
  }
  const rounded = [];
  for (let k = 0; k <= 8; k++) rounded.push([radius * Math.cos(Math.PI + Math.PI * k / 8), radius * Math.sin(Math.PI + Math.PI * k / 8)]);
  if (bucket) {
    const [outer, inner] = bucketOutline(numbers);
    for (let k = 0; k < 8; k++) solid.prism([inner[k], outer[k], outer[k + 1], inner[k + 1]], -half, half, k ? paint : steel);
    const lip = outer[8];
    if (plates) for (const z of [-half, half - 0.008]) for (let k = 0; k < 8; k++) solid.prism([lip, outer[k], outer[k + 1]], z, z + 0.008, steel);
    solid.box([lip[0] - 0.01, lip[1] - 0.02, -half * 0.4], [lip[0] + 0.06, lip[1] + 0.05, half * 0.4], dark);
    return solid;
  }
  solid.prism([...rounded, [radius, length * 0.2], [-radius, length * 0.2]], -half, half, dark);
  solid.prism([[-radius, length * 0.2], [radius, length * 0.2], [radius, length - radius], [-radius, length - radius]], -half, half, paint);
  for (const z of [-half * 0.55, half * 0.55]) {  // what carries it, behind
    solid.prism([[radius, length * 0.3], [length * 0.32, length * 0.62], [length * 0.32, length * 0.8], [radius, length * 0.9]], z - 0.012, z + 0.012, dark);
  }
  solid.box([length * 0.24, length * 0.64, -half * 0.62], [length * 0.36, length * 0.78, half * 0.62], dark);
  return solid;
}

function arrowSolid() {  // one metre along +y
  const solid = new Solid(), red = [0.78, 0.22, 0.16], n = 16;
  const p = (r, k, y) => [r * Math.cos(2 * Math.PI * k / n), y, -r * Math.sin(2 * Math.PI * k / n)];
  for (let k = 0; k < n; k++) {
    const normals = [p(1, k, 0), p(1, k + 1, 0), p(1, k + 1, 0), p(1, k, 0)];
    solid.face([p(0.02, k, 0), p(0.02, k + 1, 0), p(0.02, k + 1, 0.8), p(0.02, k, 0.8)], red, normals);
    solid.face([p(0.055, k, 0.78), p(0.055, k + 1, 0.78), [0, 1, 0]], red, [normals[0], normals[1], normals[0]]);
    solid.face([p(0.055, k + 1, 0.78), p(0.055, k, 0.78), [0, 0.78, 0]], red);
  }
  return solid;
}

const SOIL_VERTEX = `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D map; uniform mat4 view, sun; uniform ivec2 base, cells; uniform int wide, step_; uniform vec2 corner, side; uniform vec3 shift;
out vec3 place, normal; out vec2 risen; out vec4 seen;
void main() {
  ivec2 k = clamp(base + step_ * ivec2(gl_VertexID % wide, gl_VertexID / wide), ivec2(0), cells - 1);
  vec4 here = texelFetch(map, k.yx, 0);
  float y = here.r;
  vec2 slope = (vec2(floor(here.a / 4096.0), mod(here.a, 4096.0)) - 2048.0) / 512.0;
  normal = vec3(-slope.x, 1.0, -slope.y);
  vec2 at = corner + side * (vec2(k) + 0.5);
  place = vec3(at.x, y, at.y) + shift;
  risen = vec2(here.g, here.b);
  seen = sun * vec4(place, 1.0);
  gl_Position = view * vec4(place, 1.0);
}`;
const SOIL_FRAGMENT = `#version 300 es
precision highp float; precision highp sampler2DShadow;
in vec3 place, normal; in vec2 risen; in vec4 seen;
uniform sampler2DShadow shadow; uniform vec3 light, paper, middle; uniform float range, reach, ghost;
out vec4 colour;
float hash(vec2 p) { p = fract(p * vec2(0.1031, 0.1370)); p += dot(p, p.yx + 33.33); return fract((p.x + p.y) * p.x * 7.31); }
void main() {
  float grain = hash(floor(place.xz * 420.0)) + 0.6 * hash(floor(place.xz * 130.0 + 7.0));
  vec3 n = normalize(normal + 0.10 * vec3(grain - 0.8, 0.0, hash(floor(place.zx * 390.0)) - 0.5));
  vec3 sand = vec3(0.775, 0.665, 0.500) * (0.90 + 0.13 * grain);
  float t = clamp(risen.x / range, -1.0, 1.0), amount = smoothstep(0.02, 0.75, abs(t));
  vec3 tint = t < 0.0 ? vec3(0.20, 0.43, 0.56) : vec3(0.72, 0.38, 0.18);
  vec3 base = mix(sand, tint * (0.92 + 0.12 * grain), 0.72 * amount);
  vec3 c = seen.xyz * 0.5 + 0.5;
  float lit = 1.0;
  if (all(greaterThan(c, vec3(0.0))) && all(lessThan(c, vec3(1.0)))) lit = texture(shadow, vec3(c.xy, c.z - 0.004));
  lit = min(lit, 1.0 - 0.85 * risen.y);
  float sun = max(dot(n, light), 0.0) * lit;
  vec3 lamp = vec3(1.02, 0.96, 0.86) * 0.88 * sun + vec3(0.40, 0.43, 0.48) * (0.62 + 0.38 * n.y);
  float far = smoothstep(0.62, 1.0, length((place.xz - middle.xz) / reach));
  colour = vec4(mix(base * lamp, paper, far), 1.0);
  if (ghost > 0.5) colour.rgb = mix(colour.rgb, vec3(dot(colour.rgb, vec3(0.33))), 0.25);
}`;
const SOLID_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 p; layout(location = 1) in vec3 n; layout(location = 2) in vec3 c;
uniform mat4 view, model; out vec3 normal, tone, place;
void main() { vec4 w = model * vec4(p, 1.0); place = w.xyz; normal = mat3(model) * n; tone = c; gl_Position = view * w; }`;
const SOLID_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal, tone, place; uniform vec3 light, eye; uniform float alpha; out vec4 colour;
void main() {
  vec3 n = normalize(normal), to = normalize(eye - place);
  if (dot(n, to) < 0.0) n = -n;
  float shine = pow(max(dot(n, normalize(light + to)), 0.0), 40.0);
  vec3 lamp = vec3(1.0, 0.96, 0.88) * 0.85 * max(dot(n, light), 0.0) + vec3(0.52, 0.53, 0.55) * (0.75 + 0.25 * n.y);
  colour = vec4(tone * lamp + 0.22 * shine, alpha);
}`;
const GRAIN_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 p; layout(location = 1) in float moved; uniform mat4 view; uniform float size; out float far; out float mark;
void main() { gl_Position = view * vec4(p, 1.0); gl_PointSize = max(1.5, size / gl_Position.w); far = moved; mark = fract(float(gl_VertexID) * 0.618034); }`;
const GRAIN_FRAGMENT = `#version 300 es
precision highp float;
in float far, mark; out vec4 colour;
void main() {
  vec2 d = gl_PointCoord - 0.5; float r = dot(d, d);
  if (r > 0.25) discard;
  vec3 c = mix(vec3(0.62, 0.49, 0.33), vec3(0.86, 0.42, 0.13), clamp(far, 0.0, 1.0));
  colour = vec4(c * (0.92 + 0.25 * mark) * (1.2 - 1.4 * dot(d - vec2(-0.12, -0.15), d - vec2(-0.12, -0.15)) * 2.0), 1.0);
}`;

class Scene {
  // inView: cells from the focus to where the soil has faded away.
  constructor(canvas, inView) {
    const gl = canvas.getContext('webgl2', { antialias: (devicePixelRatio || 1) < 2 && !Scene.isSlow(), alpha: false });
    if (!gl) throw new Error('this browser has no WebGL 2, by which the page draws');
    Object.assign(this, { canvas, gl, inView, quality: Scene.isSlow() ? 0.5 : 1, azimuth: -2.55, height: 0.50, distance: 2.1, focus: [0, 0, 0] });
    this.soil = this.program(SOIL_VERTEX, SOIL_FRAGMENT);
    this.solids = this.program(SOLID_VERTEX, SOLID_FRAGMENT);
    this.grains = this.program(GRAIN_VERTEX, GRAIN_FRAGMENT);
    this.step = Scene.isSlow() ? 2 : 1;  // cells between vertices of a mesh
    this.wide = 142 / this.step;
    const index = [], outside = [], n = this.wide;
    const BAND = 7;  // columns at a time: vertices are found again in small caches
    for (let band = 0; band + 1 < n; band += BAND) for (let i = 0; i + 1 < n; i++) {
      for (let j = band; j < Math.min(band + BAND, n - 1); j++) {
        const k = i * n + j, list = this.step * (Math.hypot(i - n / 2, j - n / 2) - 2) < inView ? index : outside;
        list.push(k, k + n, k + 1, k + 1, k + n, k + n + 1);
      }
    }
    this.mesh = gl.createVertexArray();
    gl.bindVertexArray(this.mesh);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array([...index, ...outside]), gl.STATIC_DRAW);
    this.near = index.length; this.count = index.length + outside.length;
    this.points = gl.createVertexArray();
    this.dots = gl.createBuffer();
    gl.bindVertexArray(this.points);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.dots);
    gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 16, 0);
    gl.enableVertexAttribArray(1); gl.vertexAttribPointer(1, 1, gl.FLOAT, false, 16, 12);
    this.depth = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.depth);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW, SHADOW);
    for (const [name, value] of [[gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
      [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    this.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depth, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.arrow = this.upload(arrowSolid());
    gl.enable(gl.DEPTH_TEST);
  }

  // Whether the processor draws instead of a graphics card.
  static isSlow() {
    const gl = document.createElement('canvas').getContext('webgl2');
    const more = gl && gl.getExtension('WEBGL_debug_renderer_info');
    return !!more && /swiftshader|llvmpipe|software/i.test(gl.getParameter(more.UNMASKED_RENDERER_WEBGL));
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(`the scene cannot be drawn: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`the scene cannot be drawn: ${gl.getProgramInfoLog(program)}`);
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, ...uniforms };
  }

  upload(solid) {
    const gl = this.gl, vao = gl.createVertexArray(), data = new Float32Array(solid.data);
    gl.bindVertexArray(vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    for (let k = 0; k < 3; k++) { gl.enableVertexAttribArray(k); gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 36, 12 * k); }
    return { vao, count: data.length / 9 };
  }

  setTool(kind, numbers) { Object.assign(this, { tool: this.upload(toolSolid(kind, numbers)), numbers, payload: 0 }); }

  // What the bucket holds, m3.
  setPayload(volume) {
    if (volume !== this.payload && volume) this.load = this.upload(payloadSolid(this.numbers, volume));
    this.payload = volume;
  }

  // Draws all: grounds (`Ground`), tools [{pose}], arrow {from, to} or null, grains {data, count, size} or null.
  draw(grounds, tools, arrow, grains, range, reach) {
    const gl = this.gl, canvas = this.canvas, ratio = Math.min(devicePixelRatio || 1, 2) * this.quality;
    const w = Math.max(1, Math.round(canvas.clientWidth * ratio)), h = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const f = 2.2, near = 0.03 * this.distance, far = 12 * this.distance;
    const [sa, ca, sh, ch] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.height), Math.cos(this.height)];
    const eye = add(this.focus, [ca * ch, sh, -sa * ch], this.distance);
    const wide = Math.max(1, 1.25 * h / w);  // a narrow screen looks from farther away
    const lens = new Float32Array([f / wide * h / w, 0, 0, 0, 0, f / wide, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0]);
    const view = product(lens, lookFrom(eye, this.focus)), light = unit(SUN), size = 0.55 * reach;
    this.metre = f / wide * canvas.clientHeight / 2 / this.distance;  // pixels of a metre at the focus
    const box = new Float32Array([1 / size, 0, 0, 0, 0, 1 / size, 0, 0, 0, 0, -1 / (2 * size), 0, 0, 0, -1, 1]);
    const middle = tools[0].pose.slice(0, 3), fromSun = product(box, lookFrom(add(middle, light, 2 * size), middle));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.viewport(0, 0, SHADOW, SHADOW);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.solid(this.tool, placed(middle, tools[0].pose.slice(3)), fromSun, light, eye, 1);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, w, h);
    gl.clearColor(...PAPER, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const s = this.soil;
    gl.useProgram(s.program);
    gl.bindVertexArray(this.mesh);
    gl.activeTexture(gl.TEXTURE1); gl.bindTexture(gl.TEXTURE_2D, this.depth); gl.uniform1i(s.shadow, 1);
    gl.activeTexture(gl.TEXTURE0); gl.uniform1i(s.map, 0);
    gl.uniformMatrix4fv(s.view, false, view);
    gl.uniform3fv(s.light, light); gl.uniform3fv(s.paper, PAPER); gl.uniform3fv(s.middle, this.focus);
    gl.uniform1f(s.range, range); gl.uniform1f(s.reach, reach);
    grounds.forEach((ground, i) => {
      gl.bindTexture(gl.TEXTURE_2D, ground.texture);
      gl.uniformMatrix4fv(s.sun, false, product(fromSun, placed(ground.shift.map((v) => -v), [1, 0, 0, 0])));
      gl.uniform2i(s.base, ...ground.base(this.focus)); gl.uniform2i(s.cells, ...ground.n); gl.uniform1i(s.wide, this.wide); gl.uniform1i(s.step_, this.step);
      gl.uniform2fv(s.corner, ground.corner); gl.uniform2fv(s.side, ground.cell); gl.uniform3fv(s.shift, ground.shift);
      gl.uniform1f(s.ghost, i);
      gl.drawElements(gl.TRIANGLES, grounds.length > 1 ? this.count : this.near, gl.UNSIGNED_INT, 0);
    });
    tools.forEach((tool) => this.solid(this.tool, placed(tool.pose.slice(0, 3), tool.pose.slice(3)), view, light, eye, 1));
    if (this.payload) this.solid(this.load, placed(middle, tools[0].pose.slice(3)), view, light, eye, 1);
    if (grains && grains.count) {
      gl.useProgram(this.grains.program);
      gl.bindVertexArray(this.points);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.dots);
      gl.bufferData(gl.ARRAY_BUFFER, grains.data, gl.STREAM_DRAW, 0, 4 * grains.count);
      gl.uniformMatrix4fv(this.grains.view, false, view);
      gl.uniform1f(this.grains.size, grains.size * f / wide * h / 2);
      gl.drawArrays(gl.POINTS, 0, grains.count);
    }
    if (arrow) {
      const way = add(arrow.to, arrow.from, -1), long = Math.hypot(...way), up = unit(way);
      const axis = cross([0, 1, 0], up), s2 = Math.hypot(...axis), half = Math.atan2(s2, up[1]) / 2;
      const q = s2 > 1e-9 ? [Math.cos(half), ...unit(axis).map((v) => v * Math.sin(half))] : up[1] > 0 ? [1, 0, 0, 0] : [0, 1, 0, 0];
      const m = placed(arrow.from, q, [arrow.thick, long, arrow.thick]);
      gl.enable(gl.BLEND); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      gl.disable(gl.DEPTH_TEST); this.solid(this.arrow, m, view, light, eye, 0.45); gl.enable(gl.DEPTH_TEST);
      this.solid(this.arrow, m, view, light, eye, 1);
      gl.disable(gl.BLEND);
    }
  }

  solid(what, model, view, light, eye, alpha) {
    const gl = this.gl, s = this.solids;
    gl.useProgram(s.program);
    gl.uniformMatrix4fv(s.view, false, view); gl.uniformMatrix4fv(s.model, false, model);
    gl.uniform3fv(s.light, light); gl.uniform3fv(s.eye, eye); gl.uniform1f(s.alpha, alpha);
    gl.bindVertexArray(what.vao);
    gl.drawArrays(gl.TRIANGLES, 0, what.count);
  }
}

// A height map as a texture: height, rise over the old ground, shade from the soil itself.
class Ground {
  // n, corner, cell [2]; heights: n[0] x n[1] m, kept as the old ground.
  constructor(scene, n, corner, cell, heights, shift = [0, 0, 0]) {
    Object.assign(this, { scene, n, corner, cell, shift, old: Float32Array.from(heights) });
    const gl = scene.gl;
    this.horizon = Float32Array.from(heights);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, n[1], n[0]);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    this.write(heights, [0, 0], n);
  }

  // Takes over the heights of cells from `low` up to but not with `high`.
  write(heights, low, high) {
    const [rows, columns] = [high[0] - low[0], high[1] - low[1]], gl = this.scene.gl, wide = this.n[1];
    if (rows < 1 || columns < 1) return;
    if (!(this.data?.length >= 4 * rows * columns)) this.data = new Float32Array(4 * rows * columns);
    const data = this.data, light = unit(SUN);
    const drop = this.cell[1] / -light[2] * light[1], slide = this.cell[1] / -light[2] * light[0] / this.cell[0];
    const whole = Math.floor(slide), share = slide - whole, H = this.horizon;
    const code = (slope) => Math.max(0, Math.min(4095, Math.round(2048 + 512 * slope)));  // two in a float
    const clamp = (i) => Math.max(0, Math.min(this.n[0] - 1, i));
    for (let j = low[1]; j < high[1]; j++) for (let i = low[0]; i < high[0]; i++) {
      const k = i * wide + j, y = heights[k];
      let above = y;
      if (j > 0) above = (1 - share) * H[clamp(i + whole) * wide + j - 1] + share * H[clamp(i + whole + 1) * wide + j - 1] - drop;
      H[k] = Math.max(y, above);
      const right = heights[clamp(i + 1) * wide + j], left = heights[clamp(i - 1) * wide + j];
      const front = heights[i * wide + Math.min(j + 1, wide - 1)], back = heights[i * wide + Math.max(j - 1, 0)];
      const at = 4 * ((i - low[0]) * columns + j - low[1]), s = Math.max(0, Math.min(1, (above - y) / (0.35 * drop)));
      data[at] = y; data[at + 1] = y - this.old[k]; data[at + 2] = s;
      data[at + 3] = 4096 * code((right - left) / (2 * this.cell[0])) + code((front - back) / (2 * this.cell[1]));
    }
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, low[1], low[0], columns, rows, gl.RGBA, gl.FLOAT, data);
  }

  // First cell of the mesh about a place.
  base(focus) {
    return [0, 1].map((i) => {
      const size = this.scene.wide * this.scene.step, middle = Math.round((focus[2 * i] - this.shift[2 * i] - this.corner[i]) / this.cell[i]);
      return Math.max(0, Math.min(Math.max(0, this.n[i] - size), middle - size / 2)) & ~(this.scene.step - 1);
    });
  }
}
