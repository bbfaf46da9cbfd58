// The list of cameras, and the files that stay on this device.
import { ask, askJson, attempt, make, query, say } from "./api.js";
import { planFor, keptDescriptions } from "./plan.js";
import { forgetCamera, keepCamera, keptCameras } from "./store.js";
import { openDevice } from "./webgpu.js";

const $ = (id) => document.getElementById(id);
let known = [];
export let about = null;

export const chosenCamera = () => known.find((camera) => camera.name === $("camera").value && !camera.error);

export async function loadCameras(choose) {
  try {
    const kept = await keptDescriptions();
    about = await askJson("api/about", kept.length ? { signal: AbortSignal.timeout(PATIENCE_MS) } : {});
    known = about.cameras;
  } catch (error) {
    if (!error.isNoAnswer) throw error;
    known = (await keptDescriptions()).map((camera) => ({ ...camera, isKeptOnly: true }));
    if (!known.length) throw error;
    say("The computer does not answer. This device measures by itself, with the cameras that it has kept.", { plain: true });
  }
  const wanted = choose ?? $("camera").value;
  $("camera").replaceChildren(...known.map((camera) => new Option(camera.error ? `${camera.name} (damaged)` : camera.name, camera.name)));
  if (!known.length) $("camera").append(new Option("none yet", ""));
  if (known.some((camera) => camera.name === wanted)) $("camera").value = wanted;
  $("certificate").hidden = !about?.certificate;
  describe();
  if (choose) $("camera").dispatchEvent(new Event("change"));
}

const PATIENCE_MS = 10_000;  // chosen by hand: a computer that is gone answers nothing for minutes
const MOST_PIXELS = 1_000_000;  // of a frame of Live: three bytes each are sent, or 300 held on the device

// Width and height of the frames that Live measures.
export function liveSize({ width, height }) {
  const reduced = Math.max(1, Math.ceil(Math.sqrt(width * height / MOST_PIXELS)));
  return [width, height].map((n) => Math.round(n / reduced));
}

function describe() {
  const camera = known.find((one) => one.name === $("camera").value);
  $("camera-keep").disabled = !camera || Boolean(camera.error) || camera.isKeptOnly;
  if (!camera) $("camera-facts").textContent = "No camera file yet. “Calibrate” makes one, or open one.";
  else if (camera.error) $("camera-facts").textContent = camera.error;
  else $("camera-facts").textContent = `${camera.title}${camera.in_focus ? `, in focus at ${camera.in_focus}` : ""}`;
}

async function upload(name, data) {
  const { name: kept } = await (await ask("api/cameras" + query({ name }), { method: "POST", body: data })).json();
  await loadCameras(kept);
}

export async function keepHere(name) {
  const data = await (await ask(`api/cameras/${encodeURIComponent(name)}`)).arrayBuffer();
  await keepCamera(name, data);
  await showKept();
  const gpu = await openDevice().catch(() => null), camera = known.find((one) => one.name === name);
  if (gpu && camera) for (const size of new Set([liveSize(camera).join(" "), camera.working_px.join(" ")])) await planFor(name, ...size.split(" ").map(Number), gpu.exchange, { mustKeep: true }).catch((error) => { if (error.status !== 400) throw error; });  // frames that only the computer measures
}

async function showKept() {
  const kept = await keptCameras();
  $("camera-kept").replaceChildren(...kept.map(({ name, data }) => make("li", { class: "row" },
    make("span", { text: `${name}, kept on this device` }),
    make("button", { text: "Use", "aria-label": `Use ${name}`, onclick: () => attempt(() => upload(name, data)) }),
    make("a", { text: "Save as file", class: "button", download: `${name}.asdf`, href: URL.createObjectURL(new Blob([data])) }),
    make("button", { text: "Remove", "aria-label": `Remove ${name} from this device`, onclick: () => attempt(async () => { await forgetCamera(name); await showKept(); }) }))));
}

export function startCameras() {
  $("camera").addEventListener("change", describe);
  $("camera-menu").addEventListener("click", () => {
    $("camera-panel").hidden = !$("camera-panel").hidden;
    $("camera-menu").setAttribute("aria-expanded", String(!$("camera-panel").hidden));
  });
  $("camera-file").addEventListener("change", () => attempt(async () => {
    const [file] = $("camera-file").files;
    $("camera-file").value = "";
    if (file) { await upload(file.name, file); say(""); }
  }));
  $("camera-keep").addEventListener("click", () => attempt(async () => {
    await keepHere($("camera").value);
    say("Kept on this device; it stays when the computer is off.", { plain: true });
  }));
  attempt(showKept);
}
