// Maps that share one cursor and one detail: colours from their values, the values where the cursor is.
const content = JSON.parse(document.getElementById('data').textContent);

async function unpacked(text, itemBytes) {
  const packed = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  if (itemBytes === 1) return planes;
  const count = planes.length / itemBytes, whole = new Uint8Array(planes.length);
  for (let b = 0; b < itemBytes; b++)
    for (let i = 0, from = b * count; i < count; i++) whole[i * itemBytes + b] = planes[from + i];
  return new Float32Array(whole.buffer);
}

const detail = { scale: 1, x: 0, y: 0 };  // magnification, and the top left corner as a fraction of the picture
const panels = [];
const place = document.getElementById('place');

function element(name, parent, style, text) {
  const made = document.createElement(name);
  if (style) made.className = style;
  if (text) made.textContent = text;
  parent.append(made);
  return made;
}

function number(value, digits, unit) { return `${value.toFixed(digits)}${unit ? ' ' + unit : ''}`; }

async function drawMap(panel, canvas) {
  const { columns, rows, low, high } = panel;
  panel.pixels = await unpacked(panel.values, 4);
  const colours = Uint8Array.from(atob(panel.palette), c => c.charCodeAt(0));
  canvas.width = columns; canvas.height = rows;
  const image = new ImageData(columns, rows), out = image.data;
  for (let i = 0; i < columns * rows; i++) {
    const value = panel.pixels[i];
    const level = Number.isFinite(value) ? Math.min(255, Math.max(0, Math.floor((value - low) / (high - low) * 256))) : 256;
    out.set(colours.subarray(3 * level, 3 * level + 3), 4 * i);
    out[4 * i + 3] = 255;
  }
  canvas.getContext('2d').putImageData(image, 0, 0);
  const bar = panel.bar.getContext('2d');
  panel.bar.width = 256; panel.bar.height = 1;
  for (let i = 0; i < 256; i++) {
    bar.fillStyle = `rgb(${colours[3 * i]},${colours[3 * i + 1]},${colours[3 * i + 2]})`;
    bar.fillRect(i, 0, 1, 1);
  }
}

function show(x, y) {  // a place in the picture, as fractions of its width and height
  for (const panel of panels) {
    const column = Math.floor(x * panel.width), row = Math.floor(y * panel.height);
    const inside = x >= 0 && y >= 0 && x < 1 && y < 1;
    panel.cross.style.display = inside ? 'block' : 'none';
    if (!inside) { panel.value.textContent = ''; continue; }
    panel.cross.style.left = `${(x - detail.x) * detail.scale * 100}%`;
    panel.cross.style.top = `${(y - detail.y) * detail.scale * 100}%`;
    if (panel === panels[0]) place.textContent = `column ${column}, row ${row}`;
    if (!panel.pixels) continue;
    const value = panel.pixels[Math.floor(y * panel.height / panel.step) * panel.columns + Math.floor(x * panel.width / panel.step)];
    panel.value.textContent = Number.isFinite(value) ? number(value, panel.digits, panel.unit) : 'unknown';
  }
}

function arrange() {
  detail.x = Math.min(Math.max(detail.x, 0), 1 - 1 / detail.scale);
  detail.y = Math.min(Math.max(detail.y, 0), 1 - 1 / detail.scale);
  for (const panel of panels) {
    panel.surface.style.transform = `scale(${detail.scale}) translate(${-100 * detail.x}%, ${-100 * detail.y}%)`;
    panel.view.classList.toggle('near', detail.scale > 1);
    panel.cross.style.display = 'none';
  }
}

function zoom(factor, x = detail.x + 0.5 / detail.scale, y = detail.y + 0.5 / detail.scale) {
  const scale = Math.min(Math.max(detail.scale * factor, 1), 64);
  detail.x = x - (x - detail.x) * detail.scale / scale;
  detail.y = y - (y - detail.y) * detail.scale / scale;
  detail.scale = scale;
  arrange();
}

function listen(panel) {
  let from = null;
  const at = event => {
    const box = panel.view.getBoundingClientRect();
    return [detail.x + (event.clientX - box.left) / box.width / detail.scale,
            detail.y + (event.clientY - box.top) / box.height / detail.scale];
  };
  panel.view.addEventListener('pointerdown', event => {
    if (detail.scale > 1) { from = at(event); panel.view.setPointerCapture(event.pointerId); }
    show(...at(event));
  });
  panel.view.addEventListener('pointermove', event => {
    if (from) {
      const now = at(event);
      detail.x += from[0] - now[0]; detail.y += from[1] - now[1];
      arrange();
    }
    show(...at(event));
  });
  for (const name of ['pointerup', 'pointercancel']) panel.view.addEventListener(name, () => { from = null; });
  panel.view.addEventListener('wheel', event => {
    if (!event.ctrlKey && !event.metaKey && detail.scale === 1 && event.deltaY > 0) return;  // the page scrolls
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), ...at(event));
  }, { passive: false });
}

async function start() {
  const section = document.getElementById('panels');
  const drawn = [];
  for (const panel of content.panels) {
    const card = element('div', section, 'panel'), head = element('div', card, 'head');
    element('b', head, '', panel.title);
    panel.value = element('span', head, 'value');
    panel.view = element('div', card, 'view');
    panel.surface = element(panel.picture ? 'img' : 'canvas', panel.view);
    panel.view.style.aspectRatio = `${panel.width} / ${panel.height}`;
    panel.cross = element('div', panel.view, 'cross');
    if (panel.picture) {
      panel.surface.src = panel.picture; panel.surface.alt = panel.title; panel.surface.draggable = false;
    } else {
      const scale = element('div', card, 'scale');
      element('span', scale, '', number(panel.low, panel.digits, panel.unit));
      panel.bar = element('canvas', scale);
      element('span', scale, '', number(panel.high, panel.digits, panel.unit));
      if (panel.note) element('p', card, 'soft', panel.note);
      drawn.push(drawMap(panel, panel.surface));
    }
    panels.push(panel);
    listen(panel);
  }
  if (section) {
    document.getElementById('in').onclick = () => zoom(1.6);
    document.getElementById('out').onclick = () => zoom(1 / 1.6);
    document.getElementById('reset').onclick = () => { detail.scale = 1; detail.x = detail.y = 0; arrange(); };
  }
  await Promise.all(drawn);
  document.body.dataset.drawn = 'yes';
}
start();
