// The live view of `chromaperture live`: what a camera of the computer sees, measured there, and the model that grows of it.
import { ask, askJson, attempt, make, query, say } from "./api.js";
import { unpack } from "./frame.js";
import { unpackMessage } from "./plan.js";
import { Viewer } from "./viewer.js";

const $ = (id) => document.getElementById(id);
const STATE_MS = 1000, AGAIN_MS = 1000, HIDDEN_MS = 300;  // between two states; after a failure; in the background
const ENDED = "“chromaperture live” has ended, or does not answer. Start it again, and open the address that it prints.";
const VIEWS = { depth: "Depth", sigma: "Error bar", color: "Colour", points: "Points" };
const SLIDERS = {  // name: [row, label, unit, title]
  percent: ["watch-range", "error bar", "%", "Longest error bar shown, % of the distance"],
  near: ["watch-range", "nearest", "mm", "Nearer pixels are left out"],
  far: ["watch-range", "farthest", "mm", "Farther pixels are left out"],
  focus: ["watch-lens", "focus at", "mm", "Where the colour is in focus"],
  pupil: ["watch-lens", "pupil", "x", "Diameter of the new pupil, in units of the camera's"],
};
const sliders = {}, pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
let viewer, state = {}, mesh = 0;

export async function startWatch() {
  const { limits } = await askJson("api/live");
  $("watch").hidden = false;
  viewer = new Viewer($("watch-viewer"), VIEWS);
  for (const name of Object.keys(SLIDERS)) addSlider(name, limits[name], limits.step_mm);
  for (const [what, isOn] of [["record", "recording"], ["pause", "paused"]])
    $(`watch-${what}`).addEventListener("click", () => attempt(() => wish(what, { on: state[isOn] ? 0 : 1 })));
  $("watch-snapshot").addEventListener("click", () => attempt(() => wish("snapshot", { percent: sliders.percent.value })));
  for (const element of [$("watch-elsewhere"), sliders.focus, sliders.pupil]) element.addEventListener("change", () => attempt(focus));
  attempt(frames);
  attempt(states);
}

function addSlider(name, { lowest, highest, initial }, step_mm) {
  const [row, label, unit, title] = SLIDERS[name], id = `watch-${name}`, isDistance = unit === "mm";
  const output = make("output", { for: id });
  // "any": the ends are no whole steps
  const slider = sliders[name] = make("input", { id, type: "range", min: lowest, max: highest, step: isDistance ? step_mm : 0.1 });
  const show = () => { output.textContent = `${Number(slider.value)} ${unit}`; if (row === "watch-range" && viewer.frame) { limit(viewer.frame); viewer.draw(); } };
  $(row).append(make("label", { class: "slider", for: id, title, text: `${label} ` }, output, slider));
  slider.value = initial;
  slider.addEventListener("input", show);
  show();
}

// The farthest is a step behind the nearest at least.
function limit(frame) {
  const [percent, near, far] = ["percent", "near", "far"].map((name) => Number(sliders[name].value)), end = Math.max(far, near + Number(sliders.near.step));
  frame.limits = { most: percent / 100, near, far: end };
  Object.assign(frame.facts.depth, { low: near, high: end });
  const { depth, sigma, part } = frame.median();
  $("watch-found").textContent = part ? `median of what is shown ${Math.round(depth)} ± ${Math.round(sigma)} mm; ${Math.round(100 * part)} % of the pixels` : "no pixel is within these limits";
}

const focus = () => wish("focus", $("watch-elsewhere").checked ? { distance_mm: sliders.focus.value, pupil: sliders.pupil.value } : {});

let wishes = 0, waiting = 0;

async function wish(what, values) {
  say("");
  wishes++, waiting++;
  try { show(await (await ask(`api/live/${what}${query(values)}`, { method: "POST" })).json()); } finally { waiting--; }
}

// Repeats a task until the page is closed. What fails is said once, and no more when it goes on.
async function repeat(task) {
  let said = "";
  for (;;) {
    try {
      if (document.hidden) await pause(HIDDEN_MS);
      else await task();
      if (said) say(said = "");
    } catch (error) {
      if (said !== error.message) say(error.isNoAnswer ? ENDED : error.message);
      said = error.message;
      await pause(AGAIN_MS);
    }
  }
}

function frames() {
  let after = 0;
  return repeat(async () => {
    const answer = await ask("api/live/frame" + query({ after }));
    if (answer.status === 204) return;  // paused, or the camera gives nothing
    const frame = await unpack(await answer.arrayBuffer(), "live", "real-time");
    after = frame.facts.number;
    limit(frame);
    await viewer.setFrame(frame);
  });
}

const states = () => repeat(async () => {
  // What is asked before a wish is granted would take it back on the page.
  const isFree = !waiting, before = wishes, now = await askJson("api/live/state");
  if (isFree && before === wishes) show(now);
  const { points } = viewer;
  points?.setPath(now.path);
  if (points && now.mesh !== mesh) {
    const message = await unpackMessage(await (await ask("api/live/mesh")).arrayBuffer());
    const [vertices, triangles, colors] = await Promise.all(["vertices", "triangles", "colors"].map((name) => message.array(message[name])));
    points.setModel({ vertices, triangles, colors });
    mesh = message.mesh;
  }
  await pause(STATE_MS);
});

function show(now) {
  state = now;
  $("watch-record").textContent = state.recording ? "Stop recording" : "Record";
  $("watch-pause").textContent = state.paused ? "Go on" : "Pause";
  if (document.activeElement !== sliders.focus && document.activeElement !== sliders.pupil) $("watch-elsewhere").checked = Boolean(state.focus);
  const lines = [...state.hanging.map((text) => [text, "bad"]), [state.tracking], [state.recorded ? `${state.recorded} frames recorded` : ""], [state.latest]];
  $("watch-state").replaceChildren(...lines.filter(([text]) => text).map(([text, kind]) => make("p", { text, class: kind })));
  $("watch-stages").replaceChildren(...Object.entries(state.stages).map(([name, stage]) => make("tr", {}, make("td", { text: name }),
    ...[stage.per_second.toFixed(1), stage.milliseconds.toFixed(0), stage.latency_ms.toFixed(0), stage.dropped].map((text) => make("td", { text })))));
}
