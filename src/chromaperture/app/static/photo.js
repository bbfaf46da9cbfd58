// Photo: measure one, focus it elsewhere, save everything.
import { ask, attempt, query, say } from "./api.js";
import { chosenCamera } from "./cameras.js";
import { unpack } from "./frame.js";
import { Viewer } from "./viewer.js";

const $ = (id) => document.getElementById(id);
let viewer, photo = null, at = null, waiting = null;

export function startPhoto() {
  viewer = new Viewer($("photo-viewer"), { depth: "Depth", sigma: "Error bar", color: "Colour", picture: "Refocus" }, { onpoint: (x, y) => {
    if (viewer.view === "picture") { at = [x, y]; refocus(); }
  } });
  for (const id of ["photo-take", "photo-open"]) $(id).addEventListener("change", () => {
    const [file] = $(id).files;
    $(id).value = "";
    if (file) attempt(() => measure(file));
  });
  for (const id of ["f-number", "background", "sharpen"]) $(id).addEventListener("input", () => { showNumber(); viewer.show("picture"); refocus(); });
  viewer.buttons.at(-1).addEventListener("click", () => { if (!viewer.picture) refocus(); });
  $("photo-save").addEventListener("click", () => attempt(() => save("photo-save", "files")));
  $("photo-embed").addEventListener("click", () => attempt(() => save("photo-embed", "embedded")));
}

const fNumber = () => photo.f_number * 2 ** (Number($("f-number").value) / 2);  // a step of 1 is a stop
const showNumber = () => { $("f-value").textContent = photo?.f_number ? `f/${fNumber().toFixed(1)}` : ""; };

async function measure(file) {
  const camera = chosenCamera();
  if (!camera) return say("Choose a camera file first, or make one: “Calibrate”.");
  const quality = $("photo-quality").value;
  say(quality === "accurate" ? `Measuring ${file.name}; the best quality takes some 12 seconds a megapixel.` : `Measuring ${file.name}.`, { plain: true });
  $("photo-tools").hidden = true;
  const where = query({ camera: camera.name, quality, name: file.name });
  const frame = await unpack(await (await ask("api/photos" + where, { method: "POST", body: file })).arrayBuffer());
  photo = frame.facts;
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
    const answer = await ask(`api/photos/${now.photo}/refocused` + query(wish));
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
    const answer = await ask(`api/photos/${photo.photo}/${what}`);
    const name = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition"))?.[1] ?? "photograph.zip";
    const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(await answer.blob()), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  } finally {
    $(button).disabled = false;
  }
}
