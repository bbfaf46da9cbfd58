// Shows a frame as depth, error bar, colour or points, and the distance under the finger.
import { askJson, attempt, make } from "./api.js";
import { MOST_RELATIVE } from "./frame.js";
import { PointsCanvas } from "./points.js";

let tables;  // 257 colours of each map, from the server: the same as in every picture of the package
const tablesOnce = () => (tables ??= askJson("api/colors").catch((error) => { tables = undefined; throw error; }));

export class Viewer {
  // views: {name: label}; "picture" shows what `setPicture` was given
  constructor(root, views, { onpoint } = {}) {
    this.views = views;
    this.onpoint = onpoint;
    this.point = null;  // fractions of width and height
    this.canvas = make("canvas", { tabindex: 0, role: "img", "aria-label": "Nothing measured yet", hidden: true });
    this.pointsCanvas = make("canvas", { tabindex: 0, role: "img" });
    this.turned = make("div", { class: "turned", hidden: true }, this.pointsCanvas);
    this.empty = make("div", { class: "empty", text: "Nothing measured yet" });
    this.reading = make("div", { class: "reading", role: "status", "aria-live": "polite", hidden: true });
    this.mark = make("div", { class: "mark", hidden: true });
    this.bar = make("canvas", { width: 256, height: 1, "aria-hidden": "true" });
    this.ends = [make("span"), make("span")];
    this.note = make("span");
    this.scale = make("div", { class: "scale", hidden: true }, this.ends[0], this.bar, this.ends[1], this.note);
    this.buttons = Object.entries(views).map(([name, label]) =>
      make("button", { text: label, "aria-pressed": "false", "data-view": name, onclick: () => this.show(name) }));
    this.stage = make("div", { class: "stage" }, this.canvas, this.empty, this.reading, this.mark);
    root.append(
      this.stage, this.turned, this.scale,
      make("div", { class: "views", role: "group", "aria-label": "What to show" }, ...this.buttons));
    this.canvas.addEventListener("pointerdown", (event) => this.#touch(event));
    this.canvas.addEventListener("pointermove", (event) => { if (event.buttons || event.pointerType === "mouse") this.#touch(event, !event.buttons); });
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
    this.show("depth");
  }

  show(view) {
    this.view = view;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.view === view));
    this.draw();
  }

  async setFrame(frame) {
    this.colors = frame.colors ?? await tablesOnce();
    this.frame?.close();
    this.frame = frame;
    this.draw();
  }

  // Keeps what is shown, when the device that holds it measures something else.
  hold() { this.frame?.still?.().then((still) => this.setFrame(still)).catch(() => {}); }

  setPicture(bitmap) { this.picture = bitmap; this.draw(); }

  clear() { this.frame = this.picture = undefined; this.canvas.hidden = this.scale.hidden = true; this.empty.hidden = false; this.reading.hidden = this.mark.hidden = true; }

  draw() {
    const { frame, canvas } = this;
    if (!frame) return;
    const { width, height } = frame.facts;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.empty.hidden = true;
    const isMap = this.view === "depth" || this.view === "sigma", isPoints = this.view === "points";
    canvas.hidden = false;
    this.stage.hidden = isPoints;
    this.turned.hidden = !isPoints;
    this.scale.hidden = !isMap;
    if (isPoints) { this.#points(); return; }
    const context = canvas.getContext("2d");
    if (this.view === "picture" && this.picture) context.drawImage(this.picture, 0, 0, width, height);
    else frame.draw(context, this.view === "picture" ? "color" : this.view, this.colors);
    if (isMap) this.#bar(this.view);
    canvas.setAttribute("aria-label", `${this.views[this.view]}, ${width} by ${height} pixels, ${Math.round(100 * frame.facts.fill)} % measured. Arrow keys move the place that is read.`);
    this.#read();
  }

  // The ends of the colours.
  #bar(name) {
    const map = this.frame.facts[name], bar = this.bar.getContext("2d"), strip = bar.createImageData(256, 1);
    this.colors[name].slice(0, 256).forEach((c, i) => strip.data.set([...c, 255], 4 * i));
    bar.putImageData(strip, 0, 0);
    this.ends[0].textContent = `${round(map.low)} ${map.unit}`;
    this.ends[1].textContent = `${round(map.high)} ${map.unit}`;
    this.note.hidden = name !== "depth";
    this.note.textContent = `dark: error bar above ${Number((100 * (this.frame.limits?.most ?? MOST_RELATIVE)).toPrecision(3))} %`;
  }

  // The newest frame's points; while one is read back, later frames pass by.
  async #points() {
    if (this.isReading) return;
    this.isReading = true;
    const { frame } = this;
    await attempt(async () => {
      this.points ??= new PointsCanvas(this.pointsCanvas);
      const count = await this.points.setFrame(frame);
      this.pointsCanvas.setAttribute("aria-label", `${count} points. Drag or arrow keys turn them, wheel or two fingers come nearer, shift or the right button moves.`);
    });
    this.isReading = false;
  }

  #touch(event, hovering = false) {
    const box = this.canvas.getBoundingClientRect();
    // The picture is as large as fits into the canvas's box, in its middle (object-fit: contain).
    const scale = Math.min(box.width / this.canvas.width, box.height / this.canvas.height);
    const left = (box.width - scale * this.canvas.width) / 2, top = (box.height - scale * this.canvas.height) / 2;
    const x = (event.clientX - box.left - left) / (scale * this.canvas.width);
    const y = (event.clientY - box.top - top) / (scale * this.canvas.height);
    if (x < 0 || x >= 1 || y < 0 || y >= 1) return;
    this.point = [x, y];
    this.#read();
    if (!hovering && event.type === "pointerdown") this.onpoint?.(x, y);
  }

  #key(event) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.key === "Enter" && this.point) return this.onpoint?.(...this.point);
    if (!(event.key in steps)) return;
    event.preventDefault();
    const [x, y] = this.point ?? [0.5, 0.5], [dx, dy] = steps[event.key];
    this.point = [x + dx / 40, y + dy / 40].map((v) => Math.min(0.999, Math.max(0, v)));
    this.#read();
  }

  async #read() {
    if (!this.point || !this.frame) return;
    const [x, y] = this.point, { width, height } = this.frame.facts;
    const reading = (this.readings = (this.readings ?? 0) + 1);
    this.reading.setAttribute("aria-busy", "true");
    // Null of a device that was lost, which is said by who measures.
    const found = await Promise.resolve(this.frame.readAt(Math.floor(x * width), Math.floor(y * height))).catch(() => null);
    if (reading !== this.readings) return;
    this.reading.removeAttribute("aria-busy");
    if (!found) return;
    const { depth, sigma, unit } = found;
    const text = Number.isNaN(depth) ? "unknown here" : `${round(depth)} ± ${Number(sigma.toPrecision(2))} ${unit}`;
    if (this.reading.textContent !== text) this.reading.textContent = text;
    this.reading.hidden = this.mark.hidden = false;
    const box = this.canvas.getBoundingClientRect(), stage = this.canvas.parentElement.getBoundingClientRect();
    const scale = Math.min(box.width / width, box.height / height);
    this.mark.style.left = `${box.left - stage.left + (box.width - scale * width) / 2 + x * scale * width}px`;
    this.mark.style.top = `${box.top - stage.top + (box.height - scale * height) / 2 + y * scale * height}px`;
  }
}

const round = (value) => (Math.abs(value) >= 100 ? Math.round(value).toString() : value.toFixed(Math.abs(value) >= 10 ? 1 : 2));
