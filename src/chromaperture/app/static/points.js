// Points in 3D, those that `depth` writes into its PLY, drawn by WebGL 2; turned by a finger, the mouse or the keys.
import { Sentence } from "./api.js";

const VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D depths, colors, rays;
uniform ivec2 size;
uniform float pupil, pitch, pointSize;
uniform vec3 pivot;
uniform mat3 turn;
uniform vec2 zoom;  // towards the pivot, mm; far end of the depth buffer, mm
uniform vec4 frame;  // scale and offset from rays to the canvas
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
  vec3 seen = turn * (vec3(ray * z, z) - pivot) + pivot - vec3(0.0, 0.0, zoom.x);
  if (seen.z <= 1.0) return;
  gl_Position = vec4((seen.xy * frame.xy + seen.z * frame.zw), seen.z * (2.0 * (seen.z / zoom.y) - 1.0), seen.z);
  gl_PointSize = clamp(pointSize * pivot.z / seen.z, 1.0, 8.0);
  color = texelFetch(colors, p, 0).rgb;
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
in vec3 color;
out vec4 shown;
void main() { shown = vec4(color, 1.0); }`;
const UNIFORMS = ["depths", "colors", "rays", "size", "pupil", "pitch", "pointSize", "pivot", "turn", "zoom", "frame"];
const MOST_TURN = 1.4;  // radians, either way: what was not seen is empty

export class PointsCanvas {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Sentence("This browser draws no points: it has no WebGL 2.");
    Object.assign(this, { canvas, gl, yaw: 0, pitch: 0, near: 0, count: 0, fingers: new Map() });
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.isLost = true; });
    canvas.addEventListener("webglcontextrestored", () => { this.isLost = false; this.#start(); });
    this.#start();
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); this.fingers.set(event.pointerId, event); });
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.fingers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.#move(0, 0, -event.deltaY / 1000); }, { passive: false });
    canvas.addEventListener("dblclick", () => { this.yaw = this.pitch = this.near = 0; this.draw(); });
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  #start() {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Sentence("This browser cannot draw points (WebGL 2).");
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.at = Object.fromEntries(UNIFORMS.map((name) => [name, gl.getUniformLocation(program, name)]));
    this.textures = [0, 1, 2].map(() => gl.createTexture());
    this.shape = this.geometry = null;
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
    const [{ depth, sigma, color }, geometry] = await Promise.all([frame.maps(), frame.geometry()]), { width, height } = frame.facts, { gl } = this;
    if (this.isLost) return 0;
    const kept = new Float32Array(depth.length), sample = [];
    let count = 0;
    for (let i = 0; i < depth.length; i++) if (sigma[i] <= geometry.most_relative * depth[i]) { kept[i] = depth[i]; if (count++ % 97 === 0) sample.push(depth[i]); }
    this.#texture(0, width, height, gl.R32F, gl.RED, gl.FLOAT, kept);
    this.#texture(1, width, height, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(color.buffer));
    this.#texture(2, geometry.columns, geometry.rows, gl.RG32F, gl.RG, gl.FLOAT, geometry.rays);
    if (this.geometry !== geometry || !this.middle) {
      sample.sort((a, b) => a - b);
      this.middle = (sample[sample.length >> 1] ?? 0) - geometry.sensor_to_pupil_mm;  // stays, so that live points do not swim
      if (!sample.length) this.middle = 0;
    }
    Object.assign(this, { geometry, size: [width, height], count });
    this.draw();
    return count;
  }

  draw() {
    const { gl, at, geometry, canvas, size } = this;
    if (!geometry || this.isLost) return;
    const [width, height] = size, sharp = Math.min(window.devicePixelRatio || 1, 2);
    const across = Math.max(1, Math.round((canvas.clientWidth || width) * sharp)), down = Math.round(across * height / width);
    if (canvas.width !== across || canvas.height !== down) Object.assign(canvas, { width: across, height: down });
    gl.viewport(0, 0, across, down);
    gl.clearColor(0.047, 0.051, 0.063, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { rays, columns, rows, pitch_px: pitch } = geometry, ray = (x, y) => { const i = 2 * (Math.min(Math.round(y / pitch), rows - 1) * columns + Math.min(Math.round(x / pitch), columns - 1)); return [rays[i], rays[i + 1]]; };
    const [left] = ray(0, height / 2), [right] = ray(width - 1, height / 2), [, top] = ray(width / 2, 0), [, bottom] = ray(width / 2, height - 1);
    // What is near follows the finger.
    const [sy, cy, sp, cp] = [Math.sin(-this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    for (const [unit, name] of ["depths", "colors", "rays"].entries()) gl.uniform1i(at[name], unit);
    gl.uniform2i(at.size, width, height);
    gl.uniform1f(at.pupil, geometry.sensor_to_pupil_mm);
    gl.uniform1f(at.pitch, pitch);
    gl.uniform1f(at.pointSize, 1.6 * across / width);  // a little over the pixel, so that a surface is closed
    gl.uniform3f(at.pivot, 0, 0, this.middle);
    gl.uniformMatrix3fv(at.turn, false, [cy, sy * sp, -sy * cp, 0, cp, sp, sy, -cy * sp, cy * cp]);  // column by column
    gl.uniform2f(at.zoom, this.near * this.middle, 20 * this.middle);
    gl.uniform4f(at.frame, 2 / (right - left), -2 / (bottom - top), -(right + left) / (right - left), (bottom + top) / (bottom - top));
    gl.drawArrays(gl.POINTS, 0, width * height);
  }

  #move(yaw, pitch, near) {
    const within = (value) => Math.max(-MOST_TURN, Math.min(MOST_TURN, value));
    [this.yaw, this.pitch, this.near] = [within(this.yaw + yaw), within(this.pitch + pitch), Math.max(-2, Math.min(0.9, this.near + near))];
    this.draw();
  }

  #drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const other = [...this.fingers].find(([id]) => id !== event.pointerId)?.[1];
    this.fingers.set(event.pointerId, event);
    const apart = (finger) => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
    if (other) this.#move(0, 0, (apart(event) - apart(before)) / 300);
    else this.#move((event.clientX - before.clientX) / 200, (event.clientY - before.clientY) / 200, 0);
  }

  #key(event) {
    const step = { ArrowLeft: [-0.1, 0, 0], ArrowRight: [0.1, 0, 0], ArrowUp: [0, -0.1, 0], ArrowDown: [0, 0.1, 0], "+": [0, 0, 0.1], "-": [0, 0, -0.1] }[event.key];
    if (!step) return;
    event.preventDefault();
    this.#move(...step);
  }
}
