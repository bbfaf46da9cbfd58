// Live: frames of the device's camera, measured one after the other; the newest one wins.
import { attempt, say } from "./api.js";
import { chosenCamera, liveSize } from "./cameras.js";
import { listCameras, misfit, openCamera } from "./capture.js";
import { byComputer, measurerFor, showMode } from "./measurers.js";
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
  const [width, height] = liveSize(camera);
  const { stream, track, locked } = await openCamera(width, height, $("live-device").value);
  const video = $("live-video");
  video.srcObject = stream;
  await video.play();
  await listCameras($("live-device"));
  const run = { stream, over: false, hidden: false, abort: new AbortController() };
  running = run;
  track.addEventListener("ended", () => { if (!run.over) { stop(); say("The camera was taken away: another app uses it, or it was unplugged. Start it again."); } });
  $("live-start").textContent = "Stop";
  $("live-hint").textContent = `Touch the picture to read a distance. ${locked.length ? `Held: ${locked.join(", ")}.` : "This browser cannot hold focus or exposure; see that they stay as calibrated."}`;
  attempt(() => loop(run, video, camera, width, height).catch((error) => { if (!run.over) stop(); throw error; }));
}

async function loop(run, video, camera, width, height) {
  let measurer, between = 0, last = performance.now(), paused = "";
  const fresh = () => new Promise((resolve) => (video.requestVideoFrameCallback ? video.requestVideoFrameCallback(resolve) : requestAnimationFrame(resolve)));
  while (!run.over) {
    if (run.hidden) { $("live-speed").textContent = "paused in the background"; await new Promise((r) => setTimeout(r, 300)); last = performance.now(); continue; }
    const why = misfit(video, camera);
    if (why) {  // it may be turned back: wait
      if (why !== paused) say(why);
      paused = why;
      await new Promise((r) => setTimeout(r, 300));
      continue;
    }
    if (paused) { say(""); paused = ""; }
    measurer ??= await measurerFor(camera, width, height);
    await Promise.race([fresh(), new Promise((r) => setTimeout(r, 500))]);
    const began = performance.now();
    let frame;
    try {
      frame = await measurer.measure(video, run.abort.signal);
    } catch (error) {
      if (error.name === "AbortError" || run.over) return;
      if (error instanceof DeviceTrouble) {
        say(`Measuring on this device ended: ${error.message}. The computer goes on; choose “on this device” to try again.`);
        measurer = byComputer(camera, width, height, "");
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
