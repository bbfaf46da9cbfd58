// Photo: measure one, focus it elsewhere, save everything.
import { ask, attempt, query, say, Sentence } from "./api.js";
import { chosenCamera } from "./cameras.js";
import { unpack } from "./frame.js";
import { measurerFor, showMode } from "./measurers.js";
import { readPicture } from "./photo_file.js";
import { floatTiff } from "./tiff.js";
import { Viewer } from "./viewer.js";
import { DeviceMeasurer, DeviceTrouble } from "./webgpu.js";

const $ = (id) => document.getElementById(id);
let viewer, photo = null, at = null, waiting = null;

export function startPhoto() {
  viewer = new Viewer($("photo-viewer"), { depth: "Depth", sigma: "Error bar", color: "Colour", points: "Points", picture: "Refocus" }, { onpoint: (x, y) => {
    if (viewer.view === "picture") { at = [x, y]; refocus(); }
  } });
  for (const id of ["photo-take", "photo-open"]) $(id).addEventListener("change", () => {
    const [file, right] = $(id).files;  // of a dual-pixel camera two
    $(id).value = "";
    if (file) attempt(() => measure(file, right));
  });
  for (const id of ["f-number", "background", "sharpen"]) $(id).addEventListener("input", () => { showNumber(); viewer.show("picture"); refocus(); });
  viewer.buttons.at(-1).addEventListener("click", () => { if (!viewer.picture) refocus(); });
  $("photo-save").addEventListener("click", () => attempt(() => save("photo-save", "files")));
  $("photo-embed").addEventListener("click", () => attempt(() => save("photo-embed", "embedded")));
}

const fNumber = () => photo.f_number * 2 ** (Number($("f-number").value) / 2);  // a step of 1 is a stop
const showNumber = () => { $("f-value").textContent = photo?.f_number ? `f/${fNumber().toFixed(1)}` : ""; };

async function measure(file, right) {
  const camera = chosenCamera();
  if (!camera) return say("Choose a camera file first, or make one: “Calibrate”.");
  const quality = $("photo-quality").value;
  say(quality === "accurate" ? `Measuring ${file.name}; the best quality takes some 12 seconds a megapixel.` : `Measuring ${file.name}.`, { plain: true });
  $("photo-tools").hidden = true;
  const frame = (quality === "real-time" && $("where").value !== "computer" && !camera.dual_pixel && !right ? await byDevice(camera, file) : null) ?? await byComputer(camera, file, quality, right);
  photo = { ...frame.facts, f_number: frame.facts.f_number ?? camera.f_number, file, right, camera, quality };
  at = null;
  viewer.picture = undefined;
  await viewer.setFrame(frame);
  if (viewer.view === "picture") viewer.show("depth");
  $("photo-tools").hidden = false;
  $("f-number").value = 0;
  $("f-number").disabled = !photo.f_number;
  showNumber();
  say(photo.notes.map((note) => note[0].toUpperCase() + note.slice(1) + ".").join(" "), { plain: true });
}

// Null where this device does not measure: it cannot, or the file is none that a browser decodes.
async function byDevice(camera, file) {
  showMode("");
  const picture = await readPicture(file);
  if (!picture) { showMode("measured by the computer: RAW, TIFF and 16 bits are its work"); return null; }
  const { bitmap, notes, isHalved } = picture, other = Math.abs(bitmap.width * camera.height - bitmap.height * camera.width) > Math.max(bitmap.width, bitmap.height, camera.width, camera.height);
  if (other) throw new Sentence(`${file.name} has ${bitmap.width}x${bitmap.height} px but the camera was calibrated at ${camera.width}x${camera.height}: use its photographs as they come, or choose the camera file of this camera.`);
  try {
    const reduced = Math.max(isHalved ? 2 : 1, Math.round(bitmap.width / camera.working_px[0]));
    const measurer = await measurerFor(camera, Math.round(bitmap.width / reduced), Math.round(bitmap.height / reduced));
    if (!(measurer instanceof DeviceMeasurer)) return null;
    const began = performance.now(), frame = await (await measurer.measure(bitmap)).still();
    Object.assign(frame.facts, { seconds: (performance.now() - began) / 1000, notes: [...frame.facts.notes, ...notes] });
    return frame;
  } catch (error) {
    if (!(error instanceof DeviceTrouble)) throw error;
    showMode(`measured by the computer: ${error.message}`);
    return null;
  } finally {
    bitmap.close();
  }
}

async function byComputer(camera, file, quality, right) {
  if (!$("mode").textContent.startsWith("Measured by the computer")) showMode("measured by the computer");
  const pair = right ? { right: right.name, left_bytes: file.size } : {};
  const where = query({ camera: camera.name, quality, name: file.name, ...pair });
  return unpack(await (await ask("api/photos" + where, { method: "POST", body: right ? new Blob([file, right]) : file })).arrayBuffer(), camera.name, quality);
}

// The computer's name of a photograph: one that this device measured is sent there when it is focused elsewhere or saved.
async function sent(now) {
  if (!now.photo) {
    const mode = $("mode").textContent;
    now.photo = (await byComputer(now.camera, now.file, now.quality, now.right)).facts.photo;
    $("mode").textContent = mode;
  }
  return now.photo;
}

// Only the newest wish is computed.
async function refocus() {
  if (!photo) return;
  if (waiting) { waiting.again = true; return; }
  waiting = { again: false };
  const now = photo;
  await attempt(async () => {
    const wish = { f_number: now.f_number ? fNumber() : undefined, background: $("background").value, sharpness: $("sharpen").checked ? "fast" : "preview" };
    if (at) Object.assign(wish, { x: at[0], y: at[1] });
    viewer.reading.setAttribute("aria-busy", "true");
    const answer = await ask(`api/photos/${await sent(now)}/refocused` + query(wish));
    const bitmap = await createImageBitmap(await answer.blob());
    if (now === photo) viewer.setPicture(bitmap);
    viewer.reading.removeAttribute("aria-busy");
  });
  const { again } = waiting;
  waiting = null;
  if (again) refocus();
}

async function save(button, what) {
  $(button).disabled = true;
  try {
    const answer = await ask(`api/photos/${await sent(photo)}/${what}`);
    const name = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition"))?.[1] ?? "photograph.zip";
    download(await answer.blob(), name);
  } catch (error) {
    if (!error.isNoAnswer || photo.photo || what !== "files") throw error;
    const { depth, sigma } = viewer.frame, stem = photo.file.name.replace(/\.[^.]*$/, "");
    for (const [name, values] of Object.entries({ depth, sigma })) download(floatTiff(values, photo.width, photo.height), `${stem}.${name}.tiff`);
    say("The computer does not answer: depth and error bar are saved, as TIFF files; colours and points are its work.", { plain: true });
  } finally {
    $(button).disabled = false;
  }
}

function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
