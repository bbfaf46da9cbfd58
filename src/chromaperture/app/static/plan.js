// Plans: what Python wrote down for this device to measure by (app/device_plan.py). They are kept beside the camera files.
import { ask, query, Sentence } from "./api.js";
import { keepPlan, keptPlans } from "./store.js";

const FORMAT = 1;
const KINDS = { float32: Float32Array, int32: Int32Array, uint32: Uint32Array };

const inflated = async (bytes) => new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer());

// The text of a message, with `array(values)` for the arrays that it refers to.
export async function unpackMessage(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const text = JSON.parse(new TextDecoder().decode(await inflated(new Uint8Array(buffer, 4, length))));
  text.array = async ({ kind, numbers, at, bytes }) => (numbers ? KINDS[kind].from(numbers) : new KINDS[kind]((await unpackArray(new Uint8Array(buffer, 4 + length + at, bytes))).buffer));
  return text;
}

// The inverse of app/messages.py.
async function unpackArray(data) {
  const planes = await inflated(data), count = planes.length / 4, bits = new Int32Array(count);
  for (let i = 0, step = 0, value = 0; i < count; i++) {
    const folded = planes[i] | planes[count + i] << 8 | planes[2 * count + i] << 16 | planes[3 * count + i] << 24;
    step = (step + ((folded >>> 1) ^ -(folded & 1))) | 0;
    bits[i] = value = (value + step) | 0;
  }
  return bits;
}

const keyOf = (name, width, height, exchange) => [name, width, height, exchange].join(" ");
const loaded = new Map();  // of this visit: the computer is asked once

// The plan for a camera and a size of frame: the computer's where it answers, so that nothing gets old; else the kept one.
export async function planFor(name, width, height, exchange, { mustKeep = false, isAlone = false } = {}) {
  const key = keyOf(name, width, height, exchange);
  if (loaded.has(key) && !mustKeep) return loaded.get(key);
  const fromHere = async () => (await keptPlans()).find((plan) => plan.key === key)?.buffer;
  let buffer = isAlone ? await fromHere() : undefined;  // without the computer
  if (!buffer) try {
    buffer = await (await ask(`api/cameras/${encodeURIComponent(name)}/plan` + query({ width, height, exchange }))).arrayBuffer();
    await keepPlan({ key, name, width, height, exchange, buffer, about: (await unpackMessage(buffer)).camera }).catch((error) => { if (mustKeep) throw error; console.info("this plan is not kept:", error.message); });
  } catch (error) {
    if (!error.isNoAnswer) throw error;
    buffer = await fromHere();
    if (!buffer) throw error;
  }
  const plan = await unpackMessage(buffer);
  if (plan.plan !== FORMAT) throw new Sentence("The computer and this page are of different versions: reload the page.");
  loaded.set(key, plan);
  return plan;
}

const geometries = new Map();

// Where the rays of pixels go and what makes points of depth, from the computer: of frames that it measured.
export async function pointsGeometry({ camera, quality }, width, height) {
  const path = `api/cameras/${encodeURIComponent(camera)}/points` + query({ quality, width, height });
  if (!geometries.has(path)) geometries.set(path, await unpackGeometry(await unpackMessage(await (await ask(path)).arrayBuffer())));
  return geometries.get(path);
}

export async function unpackGeometry(message) {
  if (!message.points) throw new Sentence("This camera was never calibrated: it has no distances to make points of.");
  return { ...message.points, rays: await message.array(message.points.rays) };
}

// What is known without the computer: the cameras with a plan on this device.
export async function keptDescriptions() {
  const plans = await keptPlans().catch(() => []);
  return [...new Map(plans.map(({ about }) => [about.name, about])).values()];
}
