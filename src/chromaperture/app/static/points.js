// Points in 3D, those that `depth` writes into its PLY, and the growing model of a live view, drawn by WebGL 2; turned by a
// finger, the mouse or the keys.
import { Sentence } from "./api.js";

const VIEW = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform vec3 pivot;
uniform mat3 turn;
uniform vec3 lens;  // distance of the pivot, near and far end of the depth buffer, mm
uniform vec4 frame;  // scale and offset from rays to the canvas
vec3 seenFrom(vec3 place) { return turn * (place - pivot) + vec3(0.0, 0.0, lens.x); }
vec4 onCanvas(vec3 seen) {
  vec2 ends = vec2(lens.z + lens.y, 2.0 * lens.z * lens.y) / (lens.z - lens.y);
  return vec4(seen.xy * frame.xy + seen.z * frame.zw, ends.x * seen.z - ends.y, seen.z);
}`;
const POINTS = `${VIEW}
uniform sampler2D depths, colors, rays;
uniform ivec2 size;
uniform float pupil, pitch, pointSize, middle;
uniform mat3 poseTurn;  // of the camera in the model's world, and its place
uniform vec3 poseShift;
out vec3 color;
void main() {
  ivec2 p = ivec2(gl_VertexID % size.x, gl_VertexID / size.x);
  float depth = texelFetch(depths, p, 0).r;
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  gl_PointSize = 1.0;
  if (depth <= 0.0) return;  // unknown: outside
  vec2 at = vec2(p) / pitch;
  ivec2 i = ivec2(at);
  vec2 f = at - vec2(i);
  vec2 ray = mix(mix(texelFetch(rays, i, 0).xy, texelFetch(rays, i + ivec2(1, 0), 0).xy, f.x),
    mix(texelFetch(rays, i + ivec2(0, 1), 0).xy, texelFetch(rays, i + ivec2(1, 1), 0).xy, f.x), f.y);
  float z = depth - pupil;
  vec3 seen = seenFrom(poseTurn * vec3(ray * z, z) + poseShift);
  if (seen.z <= 1.0) return;
  gl_Position = onCanvas(seen);
  gl_PointSize = clamp(pointSize * middle / seen.z, 1.0, 8.0);
  color = texelFetch(colors, p, 0).rgb;
}`;
const PLAIN = `#version 300 es
precision mediump float;
in vec3 color;
out vec4 shown;
void main() { shown = vec4(color, 1.0); }`;
const SOLID = `${VIEW}
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 tint;
out vec3 color, seen;
void main() { seen = seenFrom(place); gl_Position = onCanvas(seen); color = tint; }`;
const LIT = `#version 300 es
precision highp float;
uniform float light;  // of a lamp beside the eye, so that forms are seen; 0 for lines
in vec3 color, seen;
out vec4 shown;
void main() {
  vec3 across = cross(dFdx(seen), dFdy(seen));
  shown = vec4(color * (1.0 - light + light * abs(across.z) / max(length(across), 1e-20)), 1.0);
}`;
const MOST_TURN = 1.4;  // radians, either way: what was not seen is empty; a model is seen from all sides
const TRACKED = [40 / 255, 120 / 255, 220 / 255], LOST = [220 / 255, 60 / 255, 40 / 255], CAMERA_MM = 100;  // the camera is drawn so large
const HERE = { turn: [1, 0, 0, 0, 1, 0, 0, 0, 1], shift: [0, 0, 0] };

export class PointsCanvas {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Sentence("This browser draws no points: it has no WebGL 2.");
    Object.assign(this, { canvas, gl, yaw: 0, pitch: 0, near: 0, moved: [0, 0, 0], count: 0, fingers: new Map(), pose: HERE, path: [], model: null });
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.isLost = true; });
    canvas.addEventListener("webglcontextrestored", () => { this.isLost = false; this.#start(); });
    this.#start();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); this.fingers.set(event.pointerId, event); });
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.fingers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.#move(0, 0, -event.deltaY / 1000); }, { passive: false });
    canvas.addEventListener("dblclick", () => { this.yaw = this.pitch = this.near = 0; this.moved = [0, 0, 0]; this.draw(); });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());  // the right button moves
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  #start() {
    const { gl } = this;
    this.programs = { points: this.#program(POINTS, PLAIN), solid: this.#program(SOLID, LIT) };
    gl.enable(gl.DEPTH_TEST);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.textures = [0, 1, 2].map(() => gl.createTexture());
    this.lines = this.#arrays([{ size: 3, data: null }]);
    this.shape = this.geometry = this.solid = null;
  }

  #program(vertex, fragment) {
    const { gl } = this, program = gl.createProgram(), at = {};
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Sentence("This browser cannot draw points (WebGL 2).");
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      at[name] = gl.getUniformLocation(program, name);
    }
    return { program, at };
  }

  // Vertex arrays with a buffer each; bytes are fractions of 255.
  #arrays(parts) {
    const { gl } = this, array = gl.createVertexArray(), buffers = parts.map(() => gl.createBuffer());
    gl.bindVertexArray(array);
    for (const [i, { size, data }] of parts.entries()) {
      const isBytes = data instanceof Uint8Array;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[i]);
      if (data) gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, size, isBytes ? gl.UNSIGNED_BYTE : gl.FLOAT, isBytes, isBytes ? 4 : 0, 0);
    }
    gl.bindVertexArray(null);
    return { array, buffers };
  }

  #texture(unit, width, height, internal, format, kind, data) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, this.textures[unit]);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, kind, data);
  }

  // Takes a frame's points; returns how many there are.
  async setFrame(frame) {
    const [{ depth, sigma, color }, geometry] = await Promise.all([frame.maps(), frame.geometry()]), { width, height, pose, lost } = frame.facts, { gl } = this;
    if (this.isLost) return 0;
    const { most = geometry.most_relative, near = 0, far = Infinity } = frame.limits ?? {}, { hidden } = frame;
    const kept = new Float32Array(depth.length), sample = [];
    let count = 0;
    for (let i = 0; i < depth.length; i++) {
      if (!(sigma[i] <= most * depth[i] && depth[i] >= near && depth[i] <= far) || hidden && hidden[i >> 3] >> 7 - (i & 7) & 1) continue;
      kept[i] = depth[i];
      if (count++ % 97 === 0) sample.push(depth[i]);
    }
    this.#texture(0, width, height, gl.R32F, gl.RED, gl.FLOAT, kept);
    this.#texture(1, width, height, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(color.buffer));
    this.#texture(2, geometry.columns, geometry.rows, gl.RG32F, gl.RG, gl.FLOAT, geometry.rays);
    if (this.geometry !== geometry || !this.middle) {
      sample.sort((a, b) => a - b);
      this.middle = (sample[sample.length >> 1] ?? 0) - geometry.sensor_to_pupil_mm;  // stays, so that live points do not swim
      if (!sample.length) this.middle = 0;
    }
    // A lost camera stays where it was seen last. Rows of the pose are columns here.
    if (pose) this.pose = { turn: [0, 1, 2].flatMap((column) => [pose[column], pose[4 + column], pose[8 + column]]), shift: [pose[3], pose[7], pose[11]] };
    Object.assign(this, { geometry, size: [width, height], count, isTracked: !lost, isPosed: Boolean(pose) || lost });
    this.draw();
    return count;
  }

  // model: {vertices: x of all, y of all, z of all, mm; triangles: likewise; colors: R, G, B and a byte of nothing}
  setModel({ vertices, triangles, colors }) {
    const turned = (values) => { const n = values.length / 3, rows = new values.constructor(values.length); for (let i = 0; i < n; i++) for (let k = 0; k < 3; k++) rows[3 * i + k] = values[k * n + i]; return rows; };
    this.model = { vertices: turned(vertices), triangles: turned(triangles), colors: new Uint8Array(colors.buffer) };
    this.#drop();
    this.draw();
  }

  // x, y, z of each place, mm
  setPath(path) { this.path = path; }

  #drop() {
    if (!this.solid) return;
    this.gl.deleteVertexArray(this.solid.array);
    for (const buffer of this.solid.buffers) this.gl.deleteBuffer(buffer);
    this.solid = null;
  }

  draw() {
    const { gl, geometry, canvas, size } = this;
    if (!geometry || this.isLost) return;
    const [width, height] = size, sharp = Math.min(window.devicePixelRatio || 1, 2);
    const across = Math.max(1, Math.round((canvas.clientWidth || width) * sharp)), down = Math.round(across * height / width);
    if (canvas.width !== across || canvas.height !== down) Object.assign(canvas, { width: across, height: down });
    gl.viewport(0, 0, across, down);
    gl.clearColor(0.047, 0.051, 0.063, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    for (const name of ["solid", "points"]) this.#look(this.programs[name]);
    this.#drawPoints(across / width);
    if (this.model) this.#drawModel();
    if (this.isPosed) this.#drawPath();
  }

  // Where the rays of the frame's edges go: left, right, top, bottom.
  #edges() {
    const { rays, columns, rows, pitch_px: pitch } = this.geometry, [width, height] = this.size;
    const ray = (x, y) => { const i = 2 * (Math.min(Math.round(y / pitch), rows - 1) * columns + Math.min(Math.round(x / pitch), columns - 1)); return [rays[i], rays[i + 1]]; };
    return [ray(0, height / 2)[0], ray(width - 1, height / 2)[0], ray(width / 2, 0)[1], ray(width / 2, height - 1)[1]];
  }

  // The turn of the view, column by column: what is near follows the finger.
  #turn() {
    const [sy, cy, sp, cp] = [Math.sin(-this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    return [cy, sy * sp, -sy * cp, 0, cp, sp, sy, -cy * sp, cy * cp];
  }

  #look({ program, at }) {
    const { gl, middle, moved } = this, [left, right, top, bottom] = this.#edges();
    gl.useProgram(program);
    gl.uniform3f(at.pivot, moved[0], moved[1], middle + moved[2]);
    gl.uniformMatrix3fv(at.turn, false, this.#turn());
    gl.uniform3f(at.lens, (1 - this.near) * middle, 0.02 * middle, 40 * middle);
    gl.uniform4f(at.frame, 2 / (right - left), -2 / (bottom - top), -(right + left) / (right - left), (bottom + top) / (bottom - top));
  }

  #drawPoints(scale) {
    const { gl, geometry, size, pose } = this, { at } = this.programs.points;
    for (const [unit, name] of ["depths", "colors", "rays"].entries()) gl.uniform1i(at[name], unit);
    gl.uniform2i(at.size, ...size);
    gl.uniform1f(at.pupil, geometry.sensor_to_pupil_mm);
    gl.uniform1f(at.pitch, geometry.pitch_px);
    gl.uniform1f(at.middle, this.middle);
    gl.uniform1f(at.pointSize, 1.6 * scale);  // a little over the pixel, so that a surface is closed
    gl.uniformMatrix3fv(at.poseTurn, false, pose.turn);
    gl.uniform3f(at.poseShift, ...pose.shift);
    gl.drawArrays(gl.POINTS, 0, size[0] * size[1]);
  }

  #drawModel() {
    const { gl, model } = this, { program, at } = this.programs.solid;
    if (!this.solid) {
      this.solid = this.#arrays([{ size: 3, data: model.vertices }, { size: 3, data: model.colors }]);
      const corners = gl.createBuffer();
      gl.bindVertexArray(this.solid.array);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, model.triangles, gl.STATIC_DRAW);
      this.solid.buffers.push(corners);
    }
    gl.useProgram(program);
    gl.uniform1f(at.light, 0.5);
    gl.bindVertexArray(this.solid.array);
    gl.drawElements(gl.TRIANGLES, model.triangles.length, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
  }

  // The path of the camera, and the camera where it is now.
  #drawPath() {
    const { gl, pose: { turn, shift }, path } = this, { program, at } = this.programs.solid, [left, right, top, bottom] = this.#edges();
    const out = ([x, y]) => [0, 1, 2].map((k) => shift[k] + CAMERA_MM * (turn[k] * x + turn[3 + k] * y + turn[6 + k]));
    const corners = [[left, top], [right, top], [right, bottom], [left, bottom]].map(out), pairs = corners.flatMap((corner, i) => [...shift, ...corner, ...corner, ...corners[(i + 1) % 4]]);
    const points = new Float32Array([...pairs, ...path, ...shift]), edges = pairs.length / 3;
    gl.useProgram(program);
    gl.uniform1f(at.light, 0);
    gl.bindVertexArray(this.lines.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lines.buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    gl.vertexAttrib3f(1, ...(this.isTracked ? TRACKED : LOST));
    gl.drawArrays(gl.LINES, 0, edges);
    gl.vertexAttrib3f(1, ...TRACKED);
    gl.drawArrays(gl.LINE_STRIP, edges, points.length / 3 - edges);
    gl.bindVertexArray(null);
  }

  #move(yaw, pitch, near) {
    const within = (value, most) => Math.max(-most, Math.min(most, value)), { model } = this;
    [this.yaw, this.pitch, this.near] = [within(this.yaw + yaw, model ? Infinity : MOST_TURN), within(this.pitch + pitch, MOST_TURN), Math.max(model ? -8 : -2, Math.min(0.9, this.near + near))];
    this.draw();
  }

  // Moves what is seen by fractions of the canvas's width.
  #shift(across, down) {
    const [left, right] = this.#edges(), turn = this.#turn(), scale = (right - left) * (1 - this.near) * this.middle;
    this.moved = this.moved.map((value, k) => value - scale * (across * turn[3 * k] + down * turn[3 * k + 1]));
    this.draw();
  }

  #drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const other = [...this.fingers].find(([id]) => id !== event.pointerId)?.[1];
    this.fingers.set(event.pointerId, event);
    const apart = (finger) => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
    if (other) this.#move(0, 0, (apart(event) - apart(before)) / 300);
    const across = event.clientX - before.clientX, down = event.clientY - before.clientY;
    if (!other && (event.shiftKey || event.buttons === 2)) this.#shift(across / this.canvas.clientWidth, down / this.canvas.clientWidth);
    else if (!other) this.#move(across / 200, down / 200, 0);
  }

  #key(event) {
    const step = { ArrowLeft: [-0.1, 0, 0], ArrowRight: [0.1, 0, 0], ArrowUp: [0, -0.1, 0], ArrowDown: [0, 0.1, 0], "+": [0, 0, 0.1], "-": [0, 0, -0.1] }[event.key];
    if (!step) return;
    event.preventDefault();
    this.#move(...step);
  }
}
