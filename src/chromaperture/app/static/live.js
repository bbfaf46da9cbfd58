// Live: frames of the device's camera, measured one after the other; the newest one wins.
import { attempt, say } from "./api.js";
import { chosenCamera, liveSize } from "./cameras.js";
import { listCameras, misfit, openCamera } from "./capture.js";
import { byComputer, measurerFor, showMode } from "./measurers.js";
import { APPROXIMATE, readFrame } from "./video_planes.js";
import { Viewer } from "./viewer.js";
import { DeviceTrouble } from "./webgpu.js";

const $ = (id) => document.getElementById(id);
let viewer, running = null;

export function startLive() {
  viewer = new Viewer($("live-viewer"), { depth: "Depth", sigma: "Error bar", color: "Colour", points: "Points" });
  $("live-start").addEventListener("click", () => attempt(() => (running ? stop() : start())));
  $("live-device").addEventListener("change", () => attempt(async () => { if (running) { stop(); await start(); } }));
  for (const id of ["camera", "where"]) $(id).addEventListener("change", () => { showMode(""); if (running) { stop(); attempt(start); } });
  document.addEventListener("visibilitychange", () => { if (running) running.hidden = document.hidden; });
  $("live-device").closest("label").hidden = true;
}

export function stop() {
  if (!running) return;
  running.over = true;
  running.abort.abort();
  for (const track of running.stream.getTracks()) track.stop();
  $("live-video").srcObject = null;
  $("live-start").textContent = "Start the camera";
  $("live-speed").textContent = "";
  running = null;
  viewer.hold();
}

async function start() {
  const camera = chosenCamera();
  if (!camera) return say("Choose a camera file first, or make one: “Calibrate”.");
  say("");
  const { stream, track, locked } = await openCamera(...liveSize(camera), $("live-device").value);
  const video = $("live-video");
  video.srcObject = stream;
  await video.play();
  await listCameras($("live-device"));
  const run = { stream, over: false, hidden: false, abort: new AbortController() };
  running = run;
  track.addEventListener("ended", () => { if (!run.over) { stop(); say("The camera was taken away: another app uses it, or it was unplugged. Start it again."); } });
  $("live-start").textContent = "Stop";
  const { isApproximate } = await readFrame(video, camera.siting);
  $("live-hint").textContent = `Touch the picture to read a distance. ${locked.length ? `Held: ${locked.join(", ")}.` : "This browser cannot hold focus or exposure; see that they stay as calibrated."}${isApproximate ? ` ${APPROXIMATE}` : ""}`;
  attempt(() => loop(run, video, track, camera).catch((error) => { if (!run.over) stop(); throw error; }));
}

// Width and height at which frames are measured, and what is to be said once: of frames that are smaller than the camera
// file's they are no larger.
function sizeFor(camera, picture) {
  const [width, height] = liveSize(camera), { holding, name } = camera, isSmaller = camera.calibrated && picture.width < width;
  const said = [
    isSmaller && once(`smaller ${name}`, `The camera file is of ${camera.width} x ${camera.height} pixels, and frames have all their colours at ${picture.width} x ${picture.height}: they are measured at that scale.`),
    !holding && once(`holding ${name}`, "This camera file does not tell how the device was held: held the other way round, near and far are exchanged."),
  ].filter(Boolean);
  if (said.length) say(said.join(" "), { plain: true });
  return isSmaller ? [picture.width, picture.height] : [width, height];
}

// A sentence, where this device was not told it yet.
function once(about, sentence) {
  const key = `chromaperture-told ${about}`;
  if (localStorage.getItem(key)) return null;
  localStorage.setItem(key, "once");
  return sentence;
}

async function loop(run, video, track, camera) {
  let measurer, size, between = 0, last = performance.now(), paused = "";
  const fresh = () => new Promise((resolve) => (video.requestVideoFrameCallback ? video.requestVideoFrameCallback(resolve) : requestAnimationFrame(resolve)));
  while (!run.over) {
    if (run.hidden) { $("live-speed").textContent = "paused in the background"; await new Promise((r) => setTimeout(r, 300)); last = performance.now(); continue; }
    const why = misfit(video, track, camera);
    if (why) {  // it may be turned back: wait
      if (why !== paused) say(why);
      paused = why;
      await new Promise((r) => setTimeout(r, 300));
      continue;
    }
    if (paused) { say(""); paused = ""; }
    await Promise.race([fresh(), new Promise((r) => setTimeout(r, 500))]);
    const began = performance.now();
    const { picture } = await readFrame(video, camera.siting);
    size ??= sizeFor(camera, picture);
    measurer ??= await measurerFor(camera, ...size);
    let frame;
    try {
      frame = await measurer.measure(picture, run.abort.signal);
    } catch (error) {
      if (error.name === "AbortError" || run.over) return;
      if (error instanceof DeviceTrouble) {
        say(`Measuring on this device ended: ${error.message}. The computer goes on; choose “on this device” to try again.`);
        measurer = byComputer(camera, ...size, "");
        continue;
      }
      say(error.message);  // the next frame may be better: lens cap, server started again
      paused = error.message;
      await new Promise((r) => setTimeout(r, 1000));
      continue;
    }
    if (run.over) return;
    await viewer.setFrame(frame);
    const now = performance.now();
    between = between ? 0.8 * between + 0.2 * (now - last) : now - last;
    last = now;
    $("live-speed").textContent = `${(1000 / between).toFixed(1)} frames/s, ${Math.round(now - began)} ms from picture to depth`;
  }
}
