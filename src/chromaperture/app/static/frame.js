// A measured frame, and who measures it: the computer that serves the page, or this device (webgpu.js).
import { ask, query } from "./api.js";
import { grab } from "./capture.js";
import { pointsGeometry } from "./plan.js";

export class ServerMeasurer {
  constructor(camera, width, height) { Object.assign(this, { camera, width, height }); }

  mode = "measured by the computer";

  // A video or a bitmap -> frame
  async measure(source, signal) {
    const { width, height, data } = grab(source, this.width, this.height);
    const rgb = new Uint8Array(3 * width * height);
    for (let i = 0, j = 0; j < rgb.length; i += 4) { rgb[j++] = data[i]; rgb[j++] = data[i + 1]; rgb[j++] = data[i + 2]; }
    const where = query({ camera: this.camera, quality: "real-time", width, height });
    return unpack(await (await ask("api/frames" + where, { method: "POST", body: rgb, signal })).arrayBuffer(), this.camera, "real-time");
  }

  close() {}
}

// The message that app/frame_message.py packs: JSON, depth and error bar in counts, colours as JPEG.
export async function unpack(buffer, camera, quality) {
  const length = new DataView(buffer).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const pixels = facts.width * facts.height;
  const depth = new Uint16Array(buffer, 4 + length, pixels);
  const sigma = new Uint16Array(buffer, 4 + length + 2 * pixels, pixels);
  const jpeg = new Blob([new Uint8Array(buffer, 4 + length + 4 * pixels, facts.color_bytes)], { type: "image/jpeg" });
  return new ServerFrame(facts, depth, sigma, await createImageBitmap(jpeg), { camera, quality });
}

export const MOST_RELATIVE = 0.1;  // error bar over depth, as depth/error_limit.py: beyond, colours are dark
const READ = 2;  // px about the place that is touched

const valueOf = (map, count) => (count ? map.first + count * map.step : NaN);

// Depth and error bar of the pixel with the median depth: the mean of two depths belongs to no surface.
export function medianAt(depths, sigmas) {
  const known = depths.map((depth, i) => [depth, sigmas[i]]).filter(([depth]) => !Number.isNaN(depth)).sort((a, b) => a[0] - b[0]);
  const [depth, sigma] = known[known.length >> 1] ?? [NaN, NaN];
  return { depth, sigma };
}

class ServerFrame {
  constructor(facts, depth, sigma, bitmap, by) { Object.assign(this, { facts, depth, sigma, bitmap, by }); }

  // colors: {depth, sigma}, 257 colours each, the last of unknown pixels
  draw(context, view, colors) {
    const { width, height } = this.facts;
    if (view === "color") return context.drawImage(this.bitmap, 0, 0, width, height);
    const map = this.facts[view], counts = this[view], lookup = this.#lookup(map, colors[view]);
    const picture = context.createImageData(width, height), out = new Uint32Array(picture.data.buffer);
    if (view === "depth" && map.unit === "mm") {
      const pale = lookup.map((color) => mix(color, lookup[0])), { sigma } = this, error = this.facts.sigma;
      for (let i = 0; i < counts.length; i++) {
        const depth = map.first + counts[i] * map.step, certain = sigma[i] && error.first + sigma[i] * error.step <= MOST_RELATIVE * depth;
        out[i] = certain ? lookup[counts[i]] : pale[counts[i]];
      }
    } else for (let i = 0; i < counts.length; i++) out[i] = lookup[counts[i]];
    context.putImageData(picture, 0, 0);
  }

  // Colour of every count, little-endian RGBA.
  #lookup(map, colors) {
    const lookup = new Uint32Array(65536), packed = colors.map(([r, g, b]) => (255 << 24 | b << 16 | g << 8 | r) >>> 0);
    lookup[0] = packed[256];
    for (let c = 1; c < 65536; c++) {
      const level = (valueOf(map, c) - map.low) / (map.high - map.low);
      lookup[c] = packed[Math.max(0, Math.min(255, Math.floor(level * 256)))];
    }
    return lookup;
  }

  readAt(x, y) {
    const { width, height, depth: { unit } } = this.facts, depths = [], sigmas = [];
    for (let v = Math.max(y - READ, 0); v <= Math.min(y + READ, height - 1); v++)
      for (let u = Math.max(x - READ, 0); u <= Math.min(x + READ, width - 1); u++) {
        depths.push(valueOf(this.facts.depth, this.depth[v * width + u]));
        sigmas.push(valueOf(this.facts.sigma, this.sigma[v * width + u]));
      }
    return { ...medianAt(depths, sigmas), unit };
  }

  // Depth and error bar, NaN unknown, and the colours (RGBA): what points are made of.
  async maps() {
    const { width, height } = this.facts;
    const [depth, sigma] = ["depth", "sigma"].map((name) => Float32Array.from(this[name], (count) => valueOf(this.facts[name], count)));
    return { depth, sigma, color: grab(this.bitmap, width, height).data };
  }

  geometry() { return pointsGeometry(this.by, this.facts.width, this.facts.height); }

  close() { this.bitmap.close(); }
}

// Colours (RGBA in 32 bits) mixed, three parts of the second.
const mix = (a, b) => [0, 8, 16].reduce((sum, bit) => sum | (((a >>> bit & 255) + 3 * (b >>> bit & 255)) >> 2) << bit, 255 << 24) >>> 0;
