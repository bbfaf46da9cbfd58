// The colours of a video's frame, from the planes that the camera stored. A canvas brings chroma up as if its samples lay
// in the middle of 2 x 2 pixels; in video they lie on the left column, so that R stands .9 px off B, more or less by the
// colour of the object: a disparity that no grey board shows. Here luma is brought down to the places of chroma instead.
import { grab } from "./capture.js";

export const APPROXIMATE = "The colours of this browser's frames are approximate: it does not give them as the camera stored them.";

const SHARES = { bt709: [0.2126, 0.0722], "bt2020-ncl": [0.2627, 0.0593], smpte170m: [0.299, 0.114], bt470bg: [0.299, 0.114] };  // of R and B in luma
const STEPS = { I420: [2, 2], NV12: [2, 2], I422: [2, 1], I444: [1, 1] };  // luma samples for one of chroma, across and down
const ORDERS = { RGBA: [0, 1, 2], RGBX: [0, 1, 2], BGRA: [2, 1, 0], BGRX: [2, 1, 0] };
const [NEAREST, PAIR, ABOUT] = [[0, 4, 0], [0, 2, 2], [1, 2, 1]];  // quarters of the samples before, at and behind a place

// The picture that a video shows, as ImageData, still encoded: half as large, or whole where its chroma is. `isApproximate`
// where this browser gives its own R, G, B only.
export async function readFrame(video, siting) {
  try {
    const frame = new VideoFrame(video);
    try {
      const isPlain = !frame.rotation && !frame.flip && frame.visibleRect.width === video.videoWidth;
      if (isPlain && (frame.format in STEPS || frame.format in ORDERS)) return { picture: await readPlanes(frame, siting), isApproximate: frame.format in ORDERS };
    } finally {
      frame.close();
    }
  } catch { /* a browser that gives no planes */ }
  return { picture: grab(video, video.videoWidth >> 1, video.videoHeight >> 1), isApproximate: true };
}

// siting: where chroma lies among its pixels, "left", "centre" or "top-left"
export async function readPlanes(frame, siting) {
  const bytes = new Uint8Array(frame.allocationSize()), planes = await frame.copyTo(bytes), { width, height } = frame.visibleRect;
  if (frame.format in ORDERS) return ofPixels(bytes, planes[0], width, height, ORDERS[frame.format]);
  const [step, stepY] = STEPS[frame.format], isNv12 = frame.format === "NV12";
  const [luma, blue, red] = isNv12 ? [planes[0], planes[1], { ...planes[1], offset: planes[1].offset + 1 }] : planes;
  const pixel = isNv12 ? 2 : 1, picture = new ImageData(Math.floor(width / step), Math.floor(height / step)), out = picture.data;
  const [left, here, right] = step === 1 ? NEAREST : siting === "centre" ? PAIR : ABOUT, down = step === 1 ? NEAREST : siting === "top-left" ? ABOUT : PAIR;
  const { gain, black, rOfRed, gOfRed, gOfBlue, bOfBlue } = matrixOf(frame.colorSpace), row = new Float32Array(width), [cb, cr] = [0, 1].map(() => new Float32Array(picture.width));
  for (let y = 0, to = 0; y < picture.height; y++) {
    const rows = [Math.max(step * y - 1, 0), step * y, Math.min(step * y + 1, height - 1)];
    mean(row, bytes, luma, rows, down, 1);
    for (const [means, plane] of [[cb, blue], [cr, red]]) mean(means, bytes, plane, stepY === step ? [y, y, y] : rows, down, pixel);
    for (let x = 0; x < picture.width; x++, to += 4) {
      const at = step * x, u = cb[x] - 128, v = cr[x] - 128;
      const light = (left * row[at > 0 ? at - 1 : 0] + here * row[at] + right * row[at + 1 < width ? at + 1 : at]) / 4, grey = gain * (light - black);
      out[to] = grey + rOfRed * v;
      out[to + 1] = grey - gOfRed * v - gOfBlue * u;
      out[to + 2] = grey + bOfBlue * u;
      out[to + 3] = 255;
    }
  }
  return picture;
}

// The weighted mean of three rows of a plane, every so many bytes.
function mean(means, bytes, { offset, stride }, rows, [before, at, behind], pixel) {
  const [top, middle, bottom] = rows.map((row) => offset + row * stride);
  for (let i = 0, from = 0; i < means.length; i++, from += pixel) means[i] = (before * bytes[top + from] + at * bytes[middle + from] + behind * bytes[bottom + from]) / 4;
}

// What makes R, G, B of Y'CbCr. Cameras that do not state a matrix have that of BT.601, as browsers take it.
function matrixOf({ matrix, fullRange }) {
  const [r, b] = SHARES[matrix] ?? SHARES.smpte170m, g = 1 - r - b, range = fullRange ? 1 : 255 / 224;
  const rOfRed = 2 * (1 - r) * range, bOfBlue = 2 * (1 - b) * range;
  return { gain: fullRange ? 1 : 255 / 219, black: fullRange ? 0 : 16, rOfRed, bOfBlue, gOfRed: rOfRed * r / g, gOfBlue: bOfBlue * b / g };
}

function ofPixels(bytes, { offset, stride }, width, height, [red, green, blue]) {
  const picture = new ImageData(width, height), out = picture.data;
  for (let y = 0, to = 0; y < height; y++) {
    for (let from = offset + y * stride, end = from + 4 * width; from < end; from += 4, to += 4) {
      [out[to], out[to + 1], out[to + 2], out[to + 3]] = [bytes[from + red], bytes[from + green], bytes[from + blue], 255];
    }
  }
  return picture;
}
