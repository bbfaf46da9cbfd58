// Points with WebGL: x right, y down, z forward in mm, as the camera has them; turned around their middle.
async function startCloud() {
  const canvas = document.getElementById('cloud'), gl = canvas.getContext('webgl', { antialias: true, preserveDrawingBuffer: true });
  if (!gl) { canvas.replaceWith('This browser has no WebGL: the points cannot be shown.'); return; }
  const points = await unpacked(content.cloud.points, 4), colours = await unpacked(content.cloud.colors, 1);
  const count = points.length / 3;
  const quantile = (fraction, value) => {
    const some = [];
    for (let i = 0; i < count; i += Math.max(1, Math.floor(count / 5000))) some.push(value(points[3 * i], points[3 * i + 1], points[3 * i + 2]));
    return some.sort((a, b) => a - b)[Math.floor(fraction * (some.length - 1))];
  };
  const middle = [quantile(0.5, x => x), quantile(0.5, (x, y) => y), quantile(0.5, (x, y, z) => z)];
  const distance = Math.hypot(...middle);
  // Half of the field of view, as tangents: all but a hundredth of the points are seen at first.
  const seen = [quantile(0.99, (x, y, z) => Math.abs(x / z)), quantile(0.99, (x, y, z) => Math.abs(y / z))];
  const pitch = Math.sqrt(4 * seen[0] * seen[1] / count);  // from point to point, if they lie in a grid before the camera
  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text); gl.compileShader(made);
    if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(made));
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 point; attribute vec3 colour; varying vec3 shade;
    uniform mat3 turn; uniform vec3 middle, shift; uniform vec2 lens; uniform float size, spacing;
    void main() {
      vec3 p = turn * (point - middle) + shift;
      float near = 0.01 * size, far = 1000.0 * size;
      gl_Position = vec4(lens.x * p.x, -lens.y * p.y, (far + near) / (far - near) * p.z - 2.0 * far * near / (far - near), p.z);
      gl_PointSize = clamp(spacing * point.z / max(p.z, 1.0), 1.5, 24.0);
      shade = colour;
    }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER,
    'precision mediump float; varying vec3 shade; void main() { gl_FragColor = vec4(shade, 1.0); }'));
  gl.linkProgram(program); gl.useProgram(program);
  for (const [name, data, kind, normal] of [['point', points, gl.FLOAT, false], ['colour', colours, gl.UNSIGNED_BYTE, true]]) {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, 3, kind, normal, 0, 0);
  }
  const uniform = name => gl.getUniformLocation(program, name);
  gl.uniform3fv(uniform('middle'), middle); gl.uniform1f(uniform('size'), distance);
  gl.enable(gl.DEPTH_TEST); gl.clearColor(0.08, 0.086, 0.1, 1);
  let yaw, tilt, shift, asked = false;
  const front = () => { yaw = 0; tilt = 0; shift = [...middle]; ask(); };
  const draw = () => {
    asked = false;
    const ratio = window.devicePixelRatio || 1, width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    const focal = 0.92 * Math.min(1 / seen[1], width / height / seen[0]);
    const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(tilt), Math.sin(tilt)];
    gl.uniformMatrix3fv(uniform('turn'), false, [cy, sy * sp, -sy * cp, 0, cp, sp, sy, -cy * sp, cy * cp]);
    gl.uniform3fv(uniform('shift'), shift);
    gl.uniform2f(uniform('lens'), focal * height / width, focal);
    gl.uniform1f(uniform('spacing'), 1.4 * pitch * focal * height / 2);  // 1.4: neighbours overlap at their corners
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawArrays(gl.POINTS, 0, count);
    canvas.dataset.drawn = count;
  };
  const ask = () => { if (!asked) { asked = true; requestAnimationFrame(draw); } };
  const touching = new Map();
  let spread = 0;
  const move = (dx, dy) => {
    const step = shift[2] / canvas.clientHeight;
    shift = [shift[0] + dx * step, shift[1] + dy * step, shift[2]];
  };
  const nearer = factor => { shift = shift.map(v => v / factor); };
  canvas.addEventListener('pointerdown', event => { touching.set(event.pointerId, event); spread = 0; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener('pointermove', event => {
    const last = touching.get(event.pointerId);
    if (!last) return;
    const dx = event.clientX - last.clientX, dy = event.clientY - last.clientY;
    touching.set(event.pointerId, event);
    if (touching.size > 1) {
      const [a, b] = [...touching.values()], now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      if (spread) nearer(now / spread);
      spread = now;
      move(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) move(dx, dy);
    else { yaw -= dx / 200; tilt = Math.min(Math.max(tilt + dy / 200, -1.5), 1.5); }
    ask();
  });
  for (const name of ['pointerup', 'pointercancel']) canvas.addEventListener(name, event => { touching.delete(event.pointerId); spread = 0; });
  canvas.addEventListener('contextmenu', event => event.preventDefault());
  canvas.addEventListener('wheel', event => { event.preventDefault(); nearer(Math.exp(-event.deltaY / 600)); ask(); }, { passive: false });
  document.getElementById('front').onclick = front;
  new ResizeObserver(ask).observe(canvas);
  front();
}
startCloud();
