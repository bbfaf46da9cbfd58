// Runs a plan (plan.js) on the graphics device of this browser. Which shaders run over which arrays is the plan's matter.
import { Sentence } from "./api.js";
import { grab } from "./capture.js";
import { medianAt, StillFrame } from "./frame.js";
import { unpackGeometry } from "./plan.js";

// The device cannot go on; a computer may.
export class DeviceTrouble extends Sentence {}

const READ = 2;  // px about the place that is touched
let opened = null;

// The device, opened once until it is lost: {device, exchange, isSoftware}.
export async function openDevice() {
  opened ??= open().catch((error) => { opened = null; throw error; });
  return opened;
}

async function open() {
  if (!navigator.gpu) throw new DeviceTrouble("this browser has no WebGPU");
  const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
  if (!adapter) throw new DeviceTrouble("this browser offers no graphics device");
  const isSoftware = Boolean(adapter.info?.isFallbackAdapter ?? adapter.isFallbackAdapter) || adapter.info?.architecture === "swiftshader";
  const hasQuads = adapter.features.has("subgroups");
  const requiredLimits = Object.fromEntries(["maxStorageBufferBindingSize", "maxBufferSize"].map((name) => [name, adapter.limits[name]]));
  let device;
  try {
    device = await adapter.requestDevice({ requiredFeatures: hasQuads ? ["subgroups"] : [], requiredLimits });
  } catch (error) {
    throw new DeviceTrouble(`the graphics device cannot be opened (${error.message})`);
  }
  const found = { device, exchange: hasQuads ? "quad" : "shared", isSoftware, isLost: false };
  device.lost.then(({ message }) => { found.isLost = true; opened = null; console.info("the graphics device was lost:", message); });
  return found;
}

export class DeviceMeasurer {
  constructor(gpu, plan) { Object.assign(this, { gpu, plan, device: gpu.device, buffers: {} }); }

  get mode() { return `measured on this device${this.gpu.isSoftware ? ", in software" : ""}`; }

  // Makes arrays and pipelines; raises DeviceTrouble where the device is too small.
  async prepare() {
    const { device, plan } = this, most = Math.min(device.limits.maxStorageBufferBindingSize, device.limits.maxBufferSize);
    const sizes = Object.values(plan.arrays).map((array) => 4 * Math.max(array.size, 4));
    const small = `the graphics device has too little memory for frames of ${plan.width} x ${plan.height}`;
    if (Math.max(...sizes) > most) throw new DeviceTrouble(small);
    device.pushErrorScope("validation");
    device.pushErrorScope("out-of-memory");
    const failed = await this.#make().then(() => null, (error) => error);
    const [memory, wrong] = [await device.popErrorScope(), await device.popErrorScope()];
    const trouble = memory ? new DeviceTrouble(small) : failed ?? (wrong && new DeviceTrouble(`the graphics device refuses the work (${wrong.message.split("\n")[0]})`));
    if (trouble) { this.close(); throw trouble; }
    return this;
  }

  async #make() {
    const { device, plan } = this;
    const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC;
    for (const [name, array] of Object.entries(plan.arrays)) {
      this.buffers[name] = device.createBuffer({ label: name, size: 4 * Math.max(array.size, 4), usage });
      if (array.values) device.queue.writeBuffer(this.buffers[name], 0, await plan.array(array.values));
    }
    const pipelines = await Promise.all(plan.sources.map((source) => this.#pipeline(source)));
    const steps = (list) => list.map(({ source, arrays, groups }) => ({ pipeline: pipelines[source], arrays, groups, bindings: this.#bindings(pipelines[source], arrays) }));
    [this.measuring, this.drawing] = [steps(plan.measure), steps(plan.draw)];
    this.canvas = new OffscreenCanvas(plan.width, plan.height);
    this.context = this.canvas.getContext("webgpu");
    this.context.configure({ device, format: "rgba8unorm", usage: GPUTextureUsage.COPY_DST | GPUTextureUsage.RENDER_ATTACHMENT, alphaMode: "opaque" });
  }

  async #pipeline(source) {
    // A browser wants to be told of subgroups.
    const module = this.device.createShaderModule({ code: (source.includes("quadSwap") ? "enable subgroups;\n" : "") + source });
    try {
      return await this.device.createComputePipelineAsync({ layout: "auto", compute: { module, entryPoint: "main" } });
    } catch (error) {
      const wrong = (await module.getCompilationInfo()).messages.find((message) => message.type === "error");
      throw this.#trouble(`a shader does not compile (${wrong ? `line ${wrong.lineNum}: ${wrong.message}` : error.message.split("\n")[0]})`);
    }
  }

  #bindings(pipeline, arrays) {
    const entries = arrays.map((name, binding) => ({ binding, resource: { buffer: this.buffers[name] } }));
    return this.device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries });
  }

  #trouble(reason) {
    return new DeviceTrouble(this.gpu.isLost ? "the graphics device was lost while it worked" : reason);
  }

  #run(encoder, steps) {
    const pass = encoder.beginComputePass();
    for (const { pipeline, bindings, groups } of steps) {
      pass.setPipeline(pipeline);
      pass.setBindGroup(0, bindings);
      pass.dispatchWorkgroups(...groups);
    }
    pass.end();
  }

  // ImageData, a bitmap or a canvas -> frame. It goes up once; the maps stay on the device.
  async measure(source) {
    const { device, plan } = this;
    if (this.gpu.isLost) throw this.#trouble();
    const encoder = device.createCommandEncoder();
    this.#send(encoder, source);
    this.#run(encoder, this.measuring);
    const parts = ["stats", "sparse"].map((name) => ({ name, offset: 0, size: 4 * plan.arrays[name].size }));
    const [stats, sparse] = await this.#read(encoder, parts);
    const numbers = new Float32Array(stats);
    for (const { at, least, says } of plan.checks) if (!(numbers[at] >= least)) throw new Sentence(`${says[0].toUpperCase()}${says.slice(1)}.`);
    return new DeviceFrame(this, sparse);
  }

  // Whole multiples of the plan's size go up as they are, and the device averages their squares; others the browser reduces.
  #send(encoder, source) {
    const { device, plan } = this;
    let { width, height } = source, from = source, side = width / plan.width;
    if (!Number.isInteger(side) || height !== side * plan.height || Math.max(width, height) > device.limits.maxTextureDimension2D) {
      [width, height, side, from] = [plan.width, plan.height, 1, grab(source, plan.width, plan.height)];
    }
    const isCounts = from instanceof ImageData;
    const pitch = isCounts ? width : Math.ceil(width / 64) * 64;  // px: WebGPU copies rows of a multiple of 256 bytes
    this.#fit("counts", 4 * pitch * height);
    device.queue.writeBuffer(this.buffers.form, 0, new Uint32Array([side, pitch, 0, 0]));
    if (isCounts) { device.queue.writeBuffer(this.buffers.counts, 0, from.data); return; }
    if (this.texture?.width !== width || this.texture?.height !== height) {
      this.texture?.destroy();
      this.texture = device.createTexture({ size: [width, height], format: "rgba8unorm", usage: GPUTextureUsage.COPY_DST | GPUTextureUsage.COPY_SRC | GPUTextureUsage.RENDER_ATTACHMENT });
    }
    device.queue.copyExternalImageToTexture({ source: from }, { texture: this.texture, colorSpace: "srgb" }, [width, height]);
    encoder.copyTextureToBuffer({ texture: this.texture }, { buffer: this.buffers.counts, bytesPerRow: 4 * pitch }, [width, height]);
  }

  // Makes an array larger where it must be; what binds it is bound anew.
  #fit(name, bytes) {
    const before = this.buffers[name];
    if (before.size >= bytes) return;
    this.buffers[name] = this.device.createBuffer({ label: name, size: bytes, usage: before.usage });
    before.destroy();
    for (const step of this.measuring) if (step.arrays.includes(name)) step.bindings = this.#bindings(step.pipeline, step.arrays);
  }

  // Submits, and reads parts of arrays back: [{name, offset, size}], bytes -> ArrayBuffers.
  async #read(encoder, parts) {
    const { device } = this, size = parts.reduce((sum, part) => sum + part.size, 0);
    const staging = device.createBuffer({ size, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    let to = 0;
    for (const part of parts) { encoder.copyBufferToBuffer(this.buffers[part.name], part.offset, staging, to, part.size); to += part.size; }
    device.queue.submit([encoder.finish()]);
    try {
      await staging.mapAsync(GPUMapMode.READ);
      const whole = staging.getMappedRange().slice(0);
      to = 0;
      return parts.map((part) => whole.slice(to, (to += part.size)));
    } catch (error) {
      await Promise.race([device.lost, new Promise((resolve) => setTimeout(resolve, 500))]);  // it is said a moment later
      throw this.#trouble(`the graphics device failed (${error.message})`);
    } finally {
      staging.destroy();
    }
  }

  readParts(parts) { return this.#read(this.device.createCommandEncoder(), parts); }

  // Draws a view into the array `picture`: number of the view, ends of its colours.
  #picture(look) {
    this.device.queue.writeBuffer(this.buffers.look, 0, new Float32Array(look));
    const encoder = this.device.createCommandEncoder();
    this.#run(encoder, this.drawing);
    return encoder;
  }

  // A view as a canvas, without leaving the device.
  drawn(look) {
    const { plan } = this, encoder = this.#picture(look), texture = this.context.getCurrentTexture();
    encoder.copyBufferToTexture({ buffer: this.buffers.picture, bytesPerRow: 4 * plan.pitch }, { texture }, [plan.width, plan.height]);
    this.device.queue.submit([encoder.finish()]);
    return this.canvas;
  }

  // A view as bytes: R, G, B, A.
  async drawnBytes(look) {
    const { width, height, pitch } = this.plan;
    const [bytes] = await this.#read(this.#picture(look), [{ name: "picture", offset: 0, size: 4 * pitch * height }]);
    const out = new Uint8ClampedArray(4 * width * height);
    for (let y = 0; y < height; y++) out.set(new Uint8Array(bytes, 4 * pitch * y, 4 * width), 4 * width * y);
    return out;
  }

  close() {
    for (const buffer of Object.values(this.buffers)) buffer.destroy();
    this.texture?.destroy();
    this.context?.unconfigure();
    this.buffers = {};
    this.isClosed = true;
  }
}

const VIEWS = { depth: 0, sigma: 1, color: 2 };

// The newest frame of a measurer; its maps are on the device.
class DeviceFrame {
  constructor(measurer, sparse) {
    this.measurer = measurer;
    const { plan } = measurer, count = plan.sparse[0] * plan.sparse[1];
    const [depth, sigma, light] = [0, 1, 2].map((part) => new Float32Array(sparse, 4 * count * part, count).filter((v) => !Number.isNaN(v)).sort());
    // As frame/preview.py: the middle 96 % of the depths, 90 % of the error bars, 99.5 % of the light.
    const [low, high] = apart(percentile(depth, 0.02), percentile(depth, 0.98)), [, most] = apart(0, percentile(sigma, 0.9));
    this.white = Math.max(percentile(light, 0.995), 1e-6);
    this.facts = {
      width: plan.width, height: plan.height, fill: depth.length / count, notes: plan.notes,
      depth: { low, high, unit: plan.unit }, sigma: { low: 0, high: most, unit: plan.unit },
    };
    this.colors = plan.colors;
  }

  #look(view) { const { low, high } = this.facts[view] ?? { low: 0, high: 1 }; return [VIEWS[view], low, high, this.white]; }

  get isGone() { return this.measurer.gpu.isLost || this.measurer.isClosed; }

  draw(context, view) {
    if (this.isGone) return;  // what was drawn last stays
    const { width, height } = this.facts;
    context.drawImage(this.measurer.drawn(this.#look(view)), 0, 0, width, height);
  }

  // Depth and error bar at a place; only what lies about it leaves the device.
  async readAt(x, y) {
    if (this.isGone) return null;
    const { width, height, depth: { unit } } = this.facts, [left, top] = [Math.max(x - READ, 0), Math.max(y - READ, 0)];
    const [across, down] = [Math.min(x + READ, width - 1) - left + 1, Math.min(y + READ, height - 1) - top + 1];
    const rows = (name) => Array.from({ length: down }, (_, v) => ({ name, offset: 4 * ((top + v) * width + left), size: 4 * across }));
    const [depths, sigmas] = this.measurer.plan.maps.map(rows);
    const found = (await this.measurer.readParts([...depths, ...sigmas])).map((part) => [...new Float32Array(part)]);
    return { ...medianAt(found.slice(0, down).flat(), found.slice(down).flat()), unit };
  }

  async geometry() { return (this.measurer.geometry ??= await unpackGeometry(this.measurer.plan)); }

  async maps() {
    const { measurer } = this, { plan } = measurer;
    const whole = plan.maps.map((name) => ({ name, offset: 0, size: 4 * plan.arrays[name].size }));
    // Both are asked for at once: the device's arrays may be the next frame's a moment later.
    const [[depth, sigma], color] = await Promise.all([measurer.readParts(whole), measurer.drawnBytes(this.#look("color"))]);
    return { depth: new Float32Array(depth), sigma: new Float32Array(sigma), color };
  }

  // The same frame with its maps read back: it stays when the device measures another.
  async still() {
    const { width, height } = this.facts, { depth, sigma, color } = await this.maps();
    const bitmap = await createImageBitmap(new ImageData(color, width, height));
    return new StillFrame(this.facts, { depth, sigma, bitmap }, { geometry: () => this.geometry(), colors: this.colors });
  }

  close() {}
}

// Of sorted numbers, linear between them as NumPy's; 0 of none.
function percentile(sorted, share) {
  if (!sorted.length) return 0;
  const at = share * (sorted.length - 1), i = Math.floor(at);
  return sorted[i] + (at - i) * ((sorted[i + 1] ?? sorted[i]) - sorted[i]);
}

const apart = (low, high) => [low, Math.max(high, low + 1e-3 * Math.max(1, Math.abs(low)))];
