// What a session has so far, as drawings (SVG).

const NS = "http://www.w3.org/2000/svg";

function svg(tag, values = {}, ...children) {
  const element = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(values)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const picture = (width, height, label, ...children) => svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label }, ...children);
const text = (x, y, content, more = {}) => svg("text", { x, y, ...more }, content);
const COLORS = { near: "#ff9f6b", far: "#6bb7ff", good: "#7bd389", line: "#343943", warm: "#e9c46a", accent: "#3cc8d8" };

// Cells of the frame: the more corners of leaning boards, the brighter.
export function frameChart(cells, covered) {
  const [rows, columns] = [cells.length, cells[0].length], w = 240 / columns, h = 160 / rows;
  const boxes = cells.flatMap((row, y) => row.map((count, x) => svg("rect", {
    x: x * w + 1, y: y * h + 1, width: w - 2, height: h - 2, rx: 3, fill: count ? COLORS.good : "#262a32", opacity: count ? Math.min(1, 0.35 + count / 40) : 1,
  })));
  return picture(240, 160, `Leaning boards cover ${Math.round(100 * covered)} percent of the frame`, ...boxes);
}

// Distances on a scale even in disparity (1 / distance), the focus marked.
export function distanceChart(boards, facts, wanted) {
  const x = (mm) => 14 + 212 * (1 / facts.nearest_mm - 1 / mm) / (1 / facts.nearest_mm - 1 / facts.farthest_mm);
  const inside = (mm) => Math.min(236, Math.max(4, x(mm)));
  const items = [
    svg("line", { x1: 14, x2: 226, y1: 80, y2: 80, stroke: COLORS.line, "stroke-width": 2 }),
    svg("line", { x1: x(facts.focus_mm), x2: x(facts.focus_mm), y1: 50, y2: 110, stroke: COLORS.warm, "stroke-width": 2, "stroke-dasharray": "4 3" }),
    text(x(facts.focus_mm), 42, `focus ${Math.round(facts.focus_mm)}`, { "text-anchor": "middle" }),
    text(8, 130, `${Math.round(facts.nearest_mm)} mm`), text(232, 130, `${Math.round(facts.farthest_mm)} mm`, { "text-anchor": "end" }),
  ];
  if (wanted) items.push(svg("circle", { cx: inside(wanted), cy: 80, r: 9, fill: "none", stroke: COLORS.accent, "stroke-width": 2.5 }));
  for (const mm of boards) items.push(svg("circle", { cx: inside(mm), cy: 80, r: 5.5, fill: mm < facts.focus_mm ? COLORS.near : COLORS.far, stroke: "#14161a" }));
  const near = boards.filter((mm) => mm < 0.95 * facts.focus_mm).length, far = boards.filter((mm) => mm > 1.05 * facts.focus_mm).length;
  return picture(240, 160, `${boards.length} boards: ${near} nearer than the focus, ${far} farther`, ...items);
}

// Leans of the boards, as seen from the camera.
export function tiltChart(leans) {
  const items = [15, 30].map((degrees) => svg("circle", { cx: 120, cy: 80, r: degrees * 2.4, fill: "none", stroke: COLORS.line }));
  items.push(text(120, 80 - 59, "30°", { "text-anchor": "middle" }));
  for (const [left, top] of leans) items.push(svg("circle", { cx: 120 - left * 2.4, cy: 80 - top * 2.4, r: 5.5, fill: COLORS.good, stroke: "#14161a" }));
  return picture(240, 160, `${leans.length} leaning boards`, ...items);
}

// By which power of the exposure decoded light grows, over its level; 1 is right.
export function toneChart(points) {
  const W = 560, H = 170, left = 52, right = 12, bottom = 34;
  const off = Math.max(0.1, ...points.map(([, power]) => Math.abs(power - 1))) * 1.2;
  const x = (level) => left + (W - left - right) * (1 + Math.log10(Math.max(level, 0.01)) / 2);
  const y = (power) => 10 + (H - 10 - bottom) * (1 - (power - 1 + off) / (2 * off));
  const items = [];
  for (const power of [1 - off / 1.2, 1, 1 + off / 1.2]) items.push(svg("line", { x1: left, x2: W - right, y1: y(power), y2: y(power), stroke: power === 1 ? COLORS.good : COLORS.line }), text(left - 6, y(power) + 4, power.toFixed(2), { "text-anchor": "end" }));
  for (const level of [0.01, 0.1, 1]) items.push(text(x(level), H - 12, `${100 * level} %`, { "text-anchor": level === 1 ? "end" : level === 0.01 ? "start" : "middle" }));
  items.push(text((left + W) / 2 + 90, H - 12, "of full scale", { "text-anchor": "middle" }));
  for (const [level, power] of points) items.push(svg("circle", { cx: x(level), cy: y(power), r: 5, fill: COLORS.accent }));
  const powers = points.map(([, power]) => power);
  return picture(W, H, `Powers from ${Math.min(...powers).toFixed(2)} to ${Math.max(...powers).toFixed(2)}`, ...items);
}

// The predicted error bar: of one pixel, of the calibration, of both.
export function forecastChart(forecast, boards) {
  const W = 560, H = 250, left = 52, bottom = 36, [first, last] = [forecast.distance_mm[0], forecast.distance_mm.at(-1)];
  const share = (name) => forecast[name].map((mm, i) => 100 * mm / forecast.distance_mm[i]);
  const most = Math.min(20, Math.max(1, ...share("total_mm")));
  const x = (mm) => left + (W - left - 12) * (mm - first) / (last - first);
  const y = (percent) => 12 + (H - 12 - bottom) * (1 - Math.min(percent, most) / most);
  const line = (name, color, width) => svg("polyline", { fill: "none", stroke: color, "stroke-width": width, points: share(name).map((p, i) => `${x(forecast.distance_mm[i])},${y(p)}`).join(" ") });
  const step = [0.2, 0.5, 1, 2, 5].find((s) => most / s <= 5) ?? 5, items = [];
  for (let p = 0; p <= most + 1e-9; p += step) items.push(svg("line", { x1: left, x2: W - 12, y1: y(p), y2: y(p), stroke: COLORS.line }), text(left - 6, y(p) + 4, `${+p.toFixed(1)} %`, { "text-anchor": "end" }));
  for (let i = 0; i <= 4; i++) { const mm = first + (last - first) * i / 4; items.push(text(x(mm), H - 12, `${Math.round(mm)}${i === 4 ? " mm" : ""}`, { "text-anchor": i === 0 ? "start" : i === 4 ? "end" : "middle" })); }
  for (const mm of boards) if (mm >= first && mm <= last) items.push(svg("circle", { cx: x(mm), cy: H - bottom, r: 4, fill: COLORS.good }));
  items.push(line("pixel_mm", COLORS.warm, 2), line("calibration_mm", COLORS.far, 2), line("total_mm", COLORS.accent, 3));
  const worst = Math.max(...share("total_mm"));
  return picture(W, H, `Expected error bar of one pixel: from ${Math.min(...share("total_mm")).toFixed(1)} to ${worst.toFixed(1)} percent of the distance`, ...items);
}
