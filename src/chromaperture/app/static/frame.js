// A measured frame, and who measures it. The server does; a measurer on this device would have the same method.
import { ask, query } from "./api.js";

export class ServerMeasurer {
  constructor(camera, quality = "real-time") { Object.assign(this, { camera, quality }); }

  // ImageData, sRGB -> frame, see `unpack`
  async measure(picture, signal) {
    const { width, height, data } = picture;
    const rgb = new Uint8Array(3 * width * height);
    for (let i = 0, j = 0; j < rgb.length; i += 4) { rgb[j++] = data[i]; rgb[j++] = data[i + 1]; rgb[j++] = data[i + 2]; }
    const where = query({ camera: this.camera, quality: this.quality, width, height });
    return unpack(await (await ask("api/frames" + where, { method: "POST", body: rgb, signal })).arrayBuffer());
  }
}

// The message that app/frame_message.py packs: JSON, depth and error bar in counts, colours as JPEG.
export async function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const pixels = facts.width * facts.height;
  const depth = new Uint16Array(buffer, 4 + length, pixels);
  const sigma = new Uint16Array(buffer, 4 + length + 2 * pixels, pixels);
  const jpeg = new Blob([new Uint8Array(buffer, 4 + length + 4 * pixels, facts.color_bytes)], { type: "image/jpeg" });
  return { facts, depth, sigma, color: await createImageBitmap(jpeg) };
}

export const valueOf = (map, count) => (count ? map.first + count * map.step : NaN);

// Depth and error bar at a place, from the known pixels around it: {depth, sigma, unit}, NaN where nothing is known.
export function readAt(frame, x, y, reach = 2) {
  const { width, height } = frame.facts, found = [];
  for (let v = Math.max(y - reach, 0); v <= Math.min(y + reach, height - 1); v++)
    for (let u = Math.max(x - reach, 0); u <= Math.min(x + reach, width - 1); u++)
      if (frame.depth[v * width + u]) found.push([frame.depth[v * width + u], frame.sigma[v * width + u]]);
  const unit = frame.facts.depth.unit;
  if (!found.length) return { depth: NaN, sigma: NaN, unit };
  found.sort((a, b) => a[0] - b[0]);
  const [depth, sigma] = found[found.length >> 1];  // of one pixel: the mean of two depths belongs to no surface
  return { depth: valueOf(frame.facts.depth, depth), sigma: valueOf(frame.facts.sigma, sigma), unit };
}
