// A measured frame, and who measures it: the computer that serves the page, or this device (webgpu.js).
import { ask, query } from "./api.js";
import { grab } from "./capture.js";
import { pointsGeometry } from "./plan.js";

export class ServerMeasurer {
  constructor(camera, width, height) { Object.assign(this, { camera, width, height }); }

  mode = "measured by the computer";

  // ImageData or a bitmap -> frame
  async measure(source, signal) {
    const { width, height, data } = grab(source, this.width, this.height);
    const rgb = new Uint8Array(3 * width * height);
    for (let i = 0, j = 0; j < rgb.length; i += 4) { rgb[j++] = data[i]; rgb[j++] = data[i + 1]; rgb[j++] = data[i + 2]; }
    const where = query({ camera: this.camera, quality: "real-time", width, height });
    return unpack(await (await ask("api/frames" + where, { method: "POST", body: rgb, signal })).arrayBuffer(), this.camera, "real-time");
  }

  close() {}
}

// The message that app/messages.py packs: JSON, depth and error bar in counts, colours as JPEG.
export async function unpack(buffer, camera, quality) {
  const length = new DataView(buffer).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const pixels = facts.width * facts.height;
  const [depth, sigma] = ["depth", "sigma"].map((name, i) => {
    const { first, step } = facts[name];
    return Float32Array.from(new Uint16Array(buffer, 4 + length + 2 * pixels * i, pixels), (count) => (count ? first + count * step : NaN));
  });
  const at = 4 + length + 4 * pixels, jpeg = new Blob([new Uint8Array(buffer, at, facts.color_bytes)], { type: "image/jpeg" });
  const bitmap = await createImageBitmap(jpeg), hidden = facts.hidden_bytes ? new Uint8Array(buffer, at + facts.color_bytes) : undefined;
  return new StillFrame(facts, { depth, sigma, bitmap, hidden }, { geometry: () => pointsGeometry({ camera, quality }, facts.width, facts.height) });
}

export const MOST_RELATIVE = 0.1;  // error bar over depth, as depth/error_limit.py: beyond, colours are dark
const EVERY = 7;  // pixel of which a median is taken
const READ = 2;  // px about the place that is touched

// Depth and error bar of the pixel with the median depth: the mean of two depths belongs to no surface.
export function medianAt(depths, sigmas) {
  const known = depths.map((depth, i) => [depth, sigmas[i]]).filter(([depth]) => !Number.isNaN(depth)).sort((a, b) => a[0] - b[0]);
  const [depth, sigma] = known[known.length >> 1] ?? [NaN, NaN];
  return { depth, sigma };
}

// A frame whose maps are here: depth and error bar, NaN unknown, the colours as a bitmap, and bits of the pixels that are no
// points. Its `limits` are what is shown: the longest error bar (of the depth), the nearest and the farthest depth, mm.
export class StillFrame {
  constructor(facts, { depth, sigma, bitmap, hidden }, { geometry, colors }) { Object.assign(this, { facts, depth, sigma, bitmap, hidden, geometry, colors, limits: {} }); }

  // colors: {depth, sigma}, 257 colours each, the last of unknown pixels
  draw(context, view, colors) {
    const { width, height } = this.facts;
    if (view === "color") return context.drawImage(this.bitmap, 0, 0, width, height);
    const { low, high, unit } = this.facts[view], values = this[view], { depth, sigma } = this, { most = MOST_RELATIVE, near = -Infinity, far = Infinity } = this.limits;
    const packed = colors[view].map(([r, g, b]) => (255 << 24 | b << 16 | g << 8 | r) >>> 0), pale = packed.map((color) => mix(color, packed[256]));
    const picture = context.createImageData(width, height), out = new Uint32Array(picture.data.buffer);
    const limit = view === "depth" && unit === "mm" ? most : Infinity, scale = 256 / (high - low);
    for (let i = 0; i < values.length; i++) {
      const value = values[i], level = !(depth[i] >= near && depth[i] <= far) ? 256 : Math.max(0, Math.min(255, Math.floor((value - low) * scale)));
      out[i] = limit === Infinity || sigma[i] <= limit * value ? packed[level] : pale[level];
    }
    context.putImageData(picture, 0, 0);
  }

  readAt(x, y) {
    const { width, height, depth: { unit } } = this.facts, depths = [], sigmas = [];
    for (let v = Math.max(y - READ, 0); v <= Math.min(y + READ, height - 1); v++)
      for (let u = Math.max(x - READ, 0); u <= Math.min(x + READ, width - 1); u++) {
        depths.push(this.depth[v * width + u]);
        sigmas.push(this.sigma[v * width + u]);
      }
    return { ...medianAt(depths, sigmas), unit };
  }

  // Median depth and error bar of some of the pixels within the limits, and the part that these are of all.
  median() {
    const { depth, sigma } = this, { most = MOST_RELATIVE, near = -Infinity, far = Infinity } = this.limits, depths = [], sigmas = [];
    for (let i = 0; i < depth.length; i += EVERY) if (sigma[i] <= most * depth[i] && depth[i] >= near && depth[i] <= far) { depths.push(depth[i]); sigmas.push(sigma[i]); }
    const middle = (values) => values.sort((a, b) => a - b)[values.length >> 1];
    return { depth: middle(depths), sigma: middle(sigmas), part: depths.length / Math.ceil(depth.length / EVERY) };
  }

  // Depth, error bar, and the colours as bytes (RGBA): what points are made of.
  async maps() {
    const { width, height } = this.facts;
    return { depth: this.depth, sigma: this.sigma, color: grab(this.bitmap, width, height).data };
  }

  close() { this.bitmap.close(); }
}

// Colours (RGBA in 32 bits) mixed, three parts of the second.
const mix = (a, b) => [0, 8, 16].reduce((sum, bit) => sum | (((a >>> bit & 255) + 3 * (b >>> bit & 255)) >> 2) << bit, 255 << 24) >>> 0;
