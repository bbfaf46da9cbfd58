// The calibration assistant: what to photograph next and why, checks of each photograph, and the calibration itself.
import { Sentence, ask, askJson, attempt, make, query, say } from "./api.js";
import { about, keepHere, loadCameras } from "./cameras.js";
import { grab, holdingOf, openCamera, turned } from "./capture.js";
import { distanceChart, forecastChart, frameChart, tiltChart, toneChart } from "./charts.js";
import { ComputerCamera } from "./sources.js";
import { APPROXIMATE, readFrame } from "./video_planes.js";

const root = () => document.getElementById("calibrate");
const KEPT = "chromaperture-session";  // which session was open, in the browser's storage
const LIVE_MS = 700;  // between two live checks, beside the time that they take
let session = null, camera = null, result = null, job = null, polling = null, watching = false;
let sources = [], chosen = -1;  // cameras of the computer; the number of one, or -1 for this device's

export function startAssistant() {
  document.addEventListener("tab", ({ detail }) => { if (detail === "calibrate") attempt(enter); else closeCamera(); });
}

async function enter() {
  const names = await askJson("api/sessions");
  sources = await askJson("api/sources");
  const name = localStorage.getItem(KEPT);
  if (names.includes(name)) await open(name);
  else showStart(names);
}

async function open(name) {
  session = await askJson(`api/sessions/${name}`);
  localStorage.setItem(KEPT, name);
  result = null;
  job = null;
  try { job = await askJson(`api/sessions/${name}/calibration`); } catch { /* none was started */ }
  draw();
  if (job?.running) poll();
}

// ---- a new session

const FIELDS = [
  ["focal_length_mm", "Focal length, mm", 50], ["f_number", "f-number", 2], ["sensor_width_mm", "Sensor width, mm", 22.3],
  ["focus_mm", "Focused at, mm", 2000], ["nearest_mm", "Nearest board, mm", 1000], ["farthest_mm", "Farthest board, mm", 4000],
  ["square_mm", "Side of a square, mm", 30], ["columns", "Inner corners across", 9], ["rows", "Inner corners down", 6],
  ["black_level", "Black level (linear files)", ""], ["white_level", "White level (linear files)", ""],
];

function showStart(names) {
  session = null;
  const inputs = Object.fromEntries(FIELDS.map(([name, label, value]) => [name, make("input", { type: "number", step: "any", min: 0, value, name, inputmode: "decimal", required: value !== "" })]));
  const name = make("input", { type: "text", name: "name", value: `session-${new Date().toISOString().slice(0, 10)}`, pattern: "[A-Za-z0-9][A-Za-z0-9_\\-]*", maxlength: 60, required: true });
  const design = make("select", { name: "design" }, ...Object.entries(about?.designs ?? {}).map(([key, title]) => new Option(title, key)));
  if (about?.designs?.cy_halves) design.value = "cy_halves";
  const form = make("form", { class: "card", onsubmit: (event) => { event.preventDefault(); attempt(create); } },
    make("h2", { text: "A new calibration" }),
    make("p", { class: "hint", text: "An evening becomes half an hour: photograph a chessboard at several distances, leaning boards, and white paper. Every photograph is checked while the board still stands there. Tape focus ring and iris first." }),
    make("div", { class: "form" },
      make("label", {}, "Name", name), make("label", {}, "Film in the pupil", design),
      ...FIELDS.map(([key, label]) => make("label", {}, label, inputs[key]))),
    make("div", { class: "row" }, make("button", { class: "main", type: "submit", text: "Begin" })));

  async function create() {
    const number = (key) => (inputs[key].value === "" ? null : Number(inputs[key].value));
    const facts = { design: design.value, inner_corners: [Math.round(number("columns")), Math.round(number("rows"))] };
    for (const [key] of FIELDS) if (key !== "columns" && key !== "rows" && number(key) !== null) facts[key] = number(key);
    session = await askJson("api/sessions", { method: "POST", body: JSON.stringify({ name: name.value, facts }) });
    localStorage.setItem(KEPT, session.name);
    say("");
    draw();
  }

  const earlier = names.length ? make("div", { class: "card" }, make("h2", { text: "Go on with" }),
    make("div", { class: "row" }, ...names.map((one) => make("button", { text: one, onclick: () => attempt(() => open(one)) })))) : null;
  root().replaceChildren(...[earlier, form].filter(Boolean));
}

// ---- an open session

const LABELS = { board: "Board, square to the camera", tilt: "Leaning board", white: "White sheet", tone: "Sheet at two exposures" };

function draw() {
  const { next } = session;
  const kind = make("select", { id: "shot-kind", "aria-label": "What is photographed" }, ...Object.entries(LABELS).map(([value, label]) => new Option(label, value)));
  const ruler = make("input", { id: "shot-ruler", type: "number", min: 1, step: 1, inputmode: "numeric", "aria-label": "Distance from the sensor's mark to the board in mm" });
  const sheet = make("select", { id: "shot-sheet", "aria-label": "Which white sheet" }, ...session.sheets.map((one) => new Option(`${one.have ? "✓ " : ""}${one.through}`, one.name)));
  const time = make("input", { id: "shot-exposure", type: "number", min: 0, step: "any", inputmode: "decimal", "aria-label": "Exposure time in ms; empty where the file states it" });
  const fit = () => { ruler.parentElement.hidden = kind.value !== "board"; sheet.parentElement.hidden = kind.value !== "white"; time.parentElement.hidden = kind.value !== "tone"; };
  kind.addEventListener("change", fit);
  if (LABELS[next.kind]) kind.value = next.kind;
  if (session.shots.at(-1)?.kind === "tone" && session.tone_error === null) kind.value = "tone";  // its second exposure
  if (next.ruler_mm) ruler.value = next.ruler_mm;
  if (next.sheet) sheet.value = next.sheet;
  const file = make("input", { id: "shot-file", type: "file", multiple: true, class: "unseen", accept: "image/*,.heic,.avif,.dng,.arw,.cr2,.cr3,.nef,.orf,.raf,.rw2,.pef,.nrw,.srw,.3fr,.rwl,.tif,.tiff" });
  const options = () => ({ kind: kind.value, ruler_mm: kind.value === "board" ? ruler.value : undefined, sheet: kind.value === "white" ? sheet.value : undefined, exposure_ms: kind.value === "tone" ? time.value || exposureOf(camera) : undefined });
  file.addEventListener("change", () => attempt(async () => {
    const files = [...file.files];
    file.value = "";
    for (const one of files) await send(one, one.name, options(), "good");
  }));
  const from = make("select", { id: "shot-from", "aria-label": "Which camera" }, new Option("This device's camera", -1), ...sources.map((source, i) => new Option(source.name, i)));
  from.value = chosen;
  from.addEventListener("change", () => { closeCamera(); chosen = Number(from.value); say(""); draw(); });
  const follow = camera?.remote && (!camera.remote.live || camera.remote.failed) ? make("button", { id: "shot-next", text: camera.remote.live ? "Look again" : "Next picture", onclick: () => attempt(lookAgain) }) : null;
  const shoot = make("button", { id: "shot-camera", text: camera ? "Photograph" : chosen < 0 ? "Use this device's camera" : "Use this camera", onclick: () => attempt(() => shutter(options())) });
  const look = camera && camera.remote?.live !== false ? make("button", { id: "shot-watch", text: "Check live", "aria-pressed": String(watching), onclick: () => { watching = !watching; look.setAttribute("aria-pressed", String(watching)); if (watching) attempt(() => watch(options)); } }) : null;

  const guide = make("section", { class: "card next", "aria-labelledby": "next-title" },
    make("h2", { id: "next-title", text: "Next" }), make("p", { class: "what", text: next.text }), make("p", { text: next.why }),
    camera ? make("div", { class: "preview" }, camera.remote?.picture ?? camera.video) : null,
    make("div", { class: "row" }, make("label", { class: "choice" }, kind), make("label", { class: "choice short" }, ruler, "mm from the sensor"), make("label", { class: "choice" }, sheet), make("label", { class: "choice short" }, time, "ms exposed")),
    make("div", { class: "row" }, make("label", { class: `button${camera ? "" : " main"}` }, "Open photographs", file), sources.length ? make("label", { class: "choice" }, from) : null, shoot, follow, look),
    make("div", { id: "checks" }, checksOf(result)));
  const panels = make("section", { class: "card", "aria-label": "What is there" },
    make("div", { class: "panels" },
      make("div", {}, make("h3", { text: `Distances: ${session.boards_mm.length}` }), distanceChart(session.boards_mm, session.facts, next.kind === "board" ? next.ruler_mm : null)),
      make("div", {}, make("h3", { text: `Frame: ${Math.round(100 * session.covered)} %` }), frameChart(session.cells, session.covered)),
      make("div", {}, make("h3", { text: `Leans: ${session.leans.length}` }), tiltChart(session.leans))));
  root().replaceChildren(
    make("div", { class: "row" }, make("h2", { text: session.name }), make("button", { class: "quiet", text: "Other session", onclick: () => attempt(leave) })),
    make("div", { class: "two" }, make("div", {}, guide, finish()), make("div", {}, panels, forecastCard(), toneCard(), shots())));
  fit();
}

async function leave() {
  closeCamera();
  localStorage.removeItem(KEPT);
  showStart(await askJson("api/sessions"));
}

function forecastCard() {
  if (!session.forecast) return null;
  const { gain } = session;
  const percent = (v) => `${(100 * v).toFixed(v < 0.1 ? 2 : 0)} %`;
  return make("section", { class: "card chart", "aria-labelledby": "forecast-title" },
    make("h2", { id: "forecast-title", text: "Expected error bar of one pixel" }), forecastChart(session.forecast, session.boards_mm),
    make("p", { class: "legend" }, key("#3cc8d8", "both together"), key("#6bb7ff", "the calibration's part"), key("#e9c46a", "noise of light, on full texture")),
    gain ? make("p", { text: `One more board at ${Math.round(gain.at_mm / 10) * 10} mm would take the calibration's part, at its worst, from ${percent(gain.before)} to ${percent(gain.after)} of the distance.` }) : null);
}

function toneCard() {
  if (!session.tone.length) return null;
  return make("section", { class: "card chart", "aria-labelledby": "tone-title" },
    make("h2", { id: "tone-title", text: "Tone curve" }), toneChart(session.tone),
    make("p", { text: `Decoded light grows with the power 1 ± ${session.tone_error.toFixed(2)} of the exposure; 1 is as assumed. The error bars allow for it.` }));
}

const key = (color, label) => { const mark = make("i"); mark.style.background = color; return make("span", {}, mark, label); };

function checksOf(found) {
  if (!found) return null;
  const state = { ok: "ok", warn: "warn", "cannot tell": "tell" }, words = { ok: "good: ", warn: "problem: ", "cannot tell": "note: " };
  const list = make("ul", { class: "checks" }, ...found.checks.map((check) => make("li", { class: state[check.verdict] },
    make("span", {}, make("span", { class: "unseen", text: words[check.verdict] }), `${check.name}: ${check.finding}`),
    check.advice ? make("span", { class: "advice", text: check.advice }) : null)));
  const head = found.kept ? `Kept as ${found.kept}.` : found.retry ? "Not kept: see what is marked." : found.usable ? "All is well; nothing is kept by a live check." : "Not yet: see what is marked.";
  const insist = found.kept || !found.retry ? null : make("button", { text: "Keep it all the same", onclick: () => attempt(() => send(...found.retry, "always")) });
  return make("div", { role: "status", "aria-live": "polite" }, make("p", { text: head }), list, insist);
}

async function send(data, name, options, keep) {
  watching = false;
  say("Checking…", { plain: true });
  const where = query({ ...options, name, keep, source: camera?.remote && !data ? camera.remote.number : undefined });
  const found = await (await ask(`api/sessions/${session.name}/shots${where}`, { method: "POST", body: data })).json();
  result = { ...found, retry: [data, name, options] };
  session = found.state;
  say("");
  draw();
}

function shots() {
  if (!session.shots.length) return null;
  return make("details", { class: "card" }, make("summary", { text: `${session.shots.length} photographs` }),
    make("ul", { class: "shots" }, ...session.shots.map((shot) => make("li", {},
      make("span", { class: shot.usable ? "" : "bad", text: `${shot.file}${shot.ruler_mm ? `, ${shot.ruler_mm} mm` : ""}${shot.usable ? "" : ": " + shot.checks.find((c) => c.verdict === "warn").finding}` }),
      make("button", { text: "Delete", "aria-label": `Delete ${shot.file}`, onclick: () => attempt(async () => {
        session = await askJson(`api/sessions/${session.name}/shots/${shot.file}`, { method: "DELETE" });
        draw();
      }) })))));
}

// ---- this device's camera

async function shutter(options) {
  if (camera?.remote) return send(null, "frame.png", options, "good");
  if (camera) return send(await photograph(), "frame.png", { ...options, ...holdingOf(camera.track) }, "good");
  if (chosen >= 0) return openRemote();
  const [width, height] = session.size_px ?? [1280, 720];
  const opened = await openCamera(width, height);
  const video = make("video", { playsinline: true, muted: true, "aria-label": "Picture of the camera" });
  video.muted = true;
  video.srcObject = opened.stream;
  camera = { ...opened, video };
  await video.play();
  const { isApproximate } = await readFrame(video);
  say(`${opened.locked.length ? `Held by the browser: ${opened.locked.join(", ")}.` : "This browser cannot hold focus, exposure and white balance: photographs opened as files are better, RAW best."}${isApproximate ? ` ${APPROXIMATE}` : ""}`, { plain: true });
  draw();
}

// A camera of the computer: live ones are shown at once, others when the next picture is asked for.
async function openRemote() {
  const remote = new ComputerCamera(chosen, sources[chosen]);
  camera = { remote };
  try {
    await remote.next();
  } catch (error) {
    closeCamera();
    throw error;
  }
  say("");
  draw();
  if (remote.live) play(remote);
  return undefined;
}

const play = (remote) => remote.play(() => { if (camera?.remote === remote) draw(); });

async function lookAgain() {
  const { remote } = camera;
  await remote.next();
  say("");
  if (!remote.live) return;
  remote.failed = false;
  draw();
  play(remote);
}

// What the browser says of the exposure of this device's camera, ms; its unit is 100 microseconds.
function exposureOf(opened) {
  const tenths = opened?.track?.getSettings?.().exposureTime;
  return tenths ? tenths / 10 : undefined;
}

async function photograph() {
  const why = turned(session.holding, camera.track), { picture } = await readFrame(camera.video);
  if (why) throw new Sentence(why);
  const [width, height] = session.size_px ?? [picture.width, picture.height];
  if (Math.abs(width / height - picture.width / picture.height) > 0.01) throw new Sentence(`The camera gives ${picture.width} x ${picture.height} pixels, and the session has ${width} x ${height}: hold the device as at the beginning.`);
  if (picture.width < width) throw new Sentence(`The camera's frames have all their colours at ${picture.width} x ${picture.height} pixels only, and the session has ${width} x ${height}: begin another session.`);
  return grab(picture, width, height, "image/png");
}

function closeCamera() {
  if (!camera) return;
  camera.remote?.close();
  for (const track of camera.stream?.getTracks() ?? []) track.stop();
  camera = null;
  watching = false;
}

// Checks what the camera sees, again and again, and keeps nothing: to turn film, board and light until all is well.
async function watch(options) {
  while (watching && camera) {
    const where = query({ ...options(), name: "frame.png", source: camera.remote?.number });
    const body = camera.remote ? null : await photograph();
    const found = await (await ask(`api/sessions/${session.name}/shots${where}`, { method: "POST", body })).json();
    if (!watching || !camera) return;
    session = found.state;  // the first photograph sets the size
    document.getElementById("checks")?.replaceChildren(checksOf(found));
    await new Promise((resolve) => setTimeout(resolve, LIVE_MS));
  }
}

// ---- the calibration

function finish() {
  const card = make("section", { class: "card", "aria-labelledby": "finish-title" }, make("h2", { id: "finish-title", text: "Calibrate" }));
  if (job?.running) {
    card.append(make("p", { text: `${job.step}${job.total ? `, ${job.done} of ${job.total}` : ""}; ${Math.round(job.seconds)} s` }),
      make("progress", job.total ? { max: job.total, value: job.done, "aria-label": "Progress" } : { "aria-label": "Progress" }),
      make("div", { class: "row" }, make("button", { text: "Stop", onclick: () => attempt(() => ask(`api/sessions/${session.name}/calibration`, { method: "DELETE" })) })));
    return card;
  }
  if (job?.error) card.append(make("p", { class: "tone-weak", text: job.error[0].toUpperCase() + job.error.slice(1) }));
  if (job?.result?.camera) card.append(...done(job.result));
  const blur = make("input", { type: "checkbox", id: "lens-blur" });
  blur.checked = true;
  card.append(
    make("p", { class: "hint", text: session.ready ? "Enough for a camera file." : "At least five distances, four leaning boards, and the white sheets make a good camera file." }),
    make("div", { class: "row" },
      make("button", { id: "calibrate-start", class: session.next.kind === "calibrate" ? "main" : "", text: job?.result?.camera ? "Calibrate again" : "Calibrate", disabled: session.boards_mm.length < 3, onclick: () => attempt(() => calibrate(blur.checked)) }),
      make("label", { class: "tick" }, blur, "fit the lens's blur too (minutes)")));
  return card;
}

function done(found) {
  const { focal_length_mm: f, in_focus: focus, baseline_mm: base } = found.summary;
  return [
    make("p", { id: "calibrated", text: found.unusable.length ? `This calibration cannot be used: ${found.unusable.join("; ")}.` : `Camera file ${found.camera} is ready: focal length ${f.toFixed(1)} mm, in focus at ${focus}, baseline ${base.toFixed(2)} mm.` }),
    make("ul", {}, ...found.sentences.map((line) => make("li", { class: `tone-${line.tone}`, text: line.text }))),
    make("div", { class: "row" },
      make("button", { class: "main", text: "Use this camera", onclick: () => attempt(async () => { await loadCameras(found.camera); document.getElementById("tab-photo").click(); }) }),
      make("a", { class: "button", text: "Save the camera file", href: `api/cameras/${found.camera}`, download: `${found.camera}.asdf` }),
      make("a", { class: "button", text: "Report", href: `api/sessions/${session.name}/report`, target: "_blank", rel: "noopener" })),
  ];
}

async function calibrate(blur) {
  closeCamera();
  job = await askJson(`api/sessions/${session.name}/calibration${query({ lens_blur: blur ? 1 : 0 })}`, { method: "POST" });
  draw();
  poll();
}

function poll() {
  clearTimeout(polling);
  polling = setTimeout(() => attempt(async () => {
    const name = session?.name;
    if (!name) return;
    job = await askJson(`api/sessions/${name}/calibration`);
    if (job.running) poll();
    else if (job.result?.camera && !job.result.unusable.length) {
      await loadCameras(job.result.camera);
      await attempt(() => keepHere(job.result.camera));  // it stays on this device; where it is full, that is said
    }
    const card = document.getElementById("finish-title")?.parentElement;
    if (card) card.replaceWith(finish());
  }), 700);
}
