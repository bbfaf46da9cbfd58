// The camera of this device, through the browser.
import { Sentence } from "./api.js";

const REASONS = {
  NotAllowedError: "The browser does not give this page the camera. Allow it in the address bar or in the system's settings, or open photographs instead.",
  SecurityError: "The browser gives the camera only to secure pages: open the https address that “chromaperture serve --lan” printed.",
  NotFoundError: "This device has no camera. Open photographs instead.",
  NotReadableError: "The camera cannot be opened: another app uses it. Close that app and try again.",
  AbortError: "The camera stopped while it was being opened. Try again.",
  OverconstrainedError: "The camera that was chosen is not there any more. Choose another one.",
};

// Opens a camera at about twice the size that is needed: averaging 2 x 2 pixels undoes what video loses in the
// resolution of colours (4:2:0). Returns {stream, track, locked}.
export async function openCamera(width, height, deviceId) {
  if (!navigator.mediaDevices?.getUserMedia) throw new Sentence(REASONS.SecurityError);
  const video = { width: { ideal: 2 * width }, height: { ideal: 2 * height }, resizeMode: "none" };
  if (deviceId) video.deviceId = { exact: deviceId };
  else video.facingMode = "environment";
  let stream;
  try {
    stream = await navigator.mediaDevices.getUserMedia({ video, audio: false });
  } catch (error) {
    throw new Sentence(REASONS[error.name] ?? `The camera cannot be opened (${error.name}). Open photographs instead.`);
  }
  const [track] = stream.getVideoTracks();
  return { stream, track, locked: await lock(track) };
}

// Holds focus, exposure and white balance where the browser can; returns what could be held.
async function lock(track) {
  const can = track.getCapabilities?.() ?? {}, now = track.getSettings?.() ?? {}, held = [];
  for (const [mode, value, name] of [["focusMode", "focusDistance", "focus"], ["exposureMode", "exposureTime", "exposure"], ["whiteBalanceMode", "colorTemperature", "white balance"]]) {
    if (!can[mode]?.includes("manual")) continue;
    const setting = { [mode]: "manual" };
    if (now[value] !== undefined) setting[value] = now[value];
    try { await track.applyConstraints({ advanced: [setting] }); held.push(name); } catch { /* it said it could */ }
  }
  return held;
}

export async function listCameras(select) {
  const devices = (await navigator.mediaDevices?.enumerateDevices?.()) ?? [];
  const cameras = devices.filter((device) => device.kind === "videoinput" && device.deviceId);
  const chosen = select.value;
  select.replaceChildren(...cameras.map((device, i) => new Option(device.label.split("/").pop() || `camera ${i + 1}`, device.deviceId)));
  if (cameras.some((device) => device.deviceId === chosen)) select.value = chosen;
  select.closest("label").hidden = cameras.length < 2;
}

// Why a video cannot be measured with a camera, null when it can: another aspect shows another part of the frame.
export function misfit(video, camera) {
  const [w, h] = [video.videoWidth, video.videoHeight];
  if (Math.abs(w * camera.height - h * camera.width) <= Math.max(w, h, camera.width, camera.height)) return null;
  if ((w > h) !== (camera.width > camera.height)) return `The picture is ${w} x ${h}, the camera file ${camera.width} x ${camera.height}: hold the device as it was calibrated.`;
  return `The camera gives ${w} x ${h} pixels, and the camera file is of ${camera.width} x ${camera.height}: another part of the frame, so distances would be wrong. Choose the camera file of this camera, or calibrate it.`;
}

const canvas = document.createElement("canvas");

// The current picture of a video, or a bitmap, in so many pixels: as ImageData, as a "canvas" or, of a type, as a Blob.
export function grab(source, width, height, type) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(source, 0, 0, width, height);
  if (type === "canvas") return canvas;
  if (!type) return context.getImageData(0, 0, width, height);
  return new Promise((resolve) => canvas.toBlob(resolve, type));
}
