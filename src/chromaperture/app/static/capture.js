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

// Opens a camera at about twice the size that is needed: video has a colour for 2 x 2 pixels only (4:2:0). Returns
// {stream, track, locked}.
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

// How the device is held, and where its camera looks; null where the browser does not say.
export function holdingOf(track) {
  const { angle, type } = screen.orientation ?? {};
  return angle === undefined ? null : { angle, orientation: type, facing: track.getSettings().facingMode ?? "" };
}

const TOPS = { 0: "up", 90: "to the left", 180: "down", 270: "to the right" }, SIDES = { user: "on the side of the screen", environment: "on the back" };

// What to do where a device is held otherwise than for a calibration, null where it is not, or one of the two is not known.
// Browsers turn frames upright, so that no picture shows it; the filters in the pupil do not turn with them.
export function turned(holding, track) {
  const now = holdingOf(track);
  if (!holding || !now) return null;
  if (holding.facing && now.facing && holding.facing !== now.facing) return `This was calibrated with the camera ${SIDES[holding.facing] ?? `“${holding.facing}”`}: choose that one.`;
  const by = Math.abs(now.angle - holding.angle_deg);
  return by ? `Turn the phone by ${by === 270 ? 90 : by}°: it was calibrated with its top ${TOPS[holding.angle_deg]}.` : null;
}

// Why a video cannot be measured with a camera, null when it can: another aspect shows another part of the frame.
export function misfit(video, track, camera) {
  const [w, h] = [video.videoWidth, video.videoHeight], why = turned(camera.holding, track);
  if (why) return why;
  if (Math.abs(w * camera.height - h * camera.width) <= Math.max(w, h, camera.width, camera.height)) return null;
  if ((w > h) !== (camera.width > camera.height)) return `The picture is ${w} x ${h}, the camera file ${camera.width} x ${camera.height}: hold the device as it was calibrated.`;
  return `The camera gives ${w} x ${h} pixels, and the camera file is of ${camera.width} x ${camera.height}: another part of the frame, so distances would be wrong. Choose the camera file of this camera, or calibrate it.`;
}

const canvas = document.createElement("canvas"), stored = document.createElement("canvas");

// The current picture of a video, a bitmap or ImageData, in so many pixels: as ImageData or, of a type, as a Blob.
export function grab(source, width, height, type) {
  if (source instanceof ImageData) {
    if (!type && source.width === width && source.height === height) return source;
    Object.assign(stored, { width: source.width, height: source.height }).getContext("2d").putImageData(source, 0, 0);
    source = stored;
  }
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(source, 0, 0, width, height);
  if (!type) return context.getImageData(0, 0, width, height);
  return new Promise((resolve) => canvas.toBlob(resolve, type));
}
