// Who measures: this device by a plan, or the computer that serves the page.
import { ServerMeasurer } from "./frame.js";
import { planFor } from "./plan.js";
import { DeviceMeasurer, DeviceTrouble, openDevice } from "./webgpu.js";

const $ = (id) => document.getElementById(id);
let last = null;  // one measurer has arrays on the device at a time

export function showMode(text) { $("mode").textContent = text ? text[0].toUpperCase() + text.slice(1) + "." : ""; }

// The measurer for a camera and a size of frame, as chosen; the computer where this device cannot, which is said.
export async function measurerFor(camera, width, height) {
  const wanted = $("where").value, key = [camera.name, width, height].join(" ");
  let why = "";
  if (wanted !== "computer") {
    try {
      const gpu = await openDevice();
      // Software is slower than the computer, and is taken only where there is no other way.
      if (wanted === "device" || !gpu.isSoftware || camera.isKeptOnly) {
        if (last?.key !== key || last.gpu !== gpu) {
          last?.close();
          last = null;
          showMode("preparing this device");
          last = Object.assign(await new DeviceMeasurer(gpu, await planFor(camera.name, width, height, gpu.exchange, { isAlone: camera.isKeptOnly })).prepare(), { key });
        }
        showMode(last.mode);
        return last;
      }
      why = ": this device has no graphics hardware for it";
    } catch (error) {
      if (!(error instanceof DeviceTrouble) && error.status !== 400) { showMode(""); throw error; }
      why = `: ${error.message[0].toLowerCase()}${error.message.slice(1).replace(/\.$/, "")}`;
    }
  }
  return byComputer(camera, width, height, why);
}

export function byComputer(camera, width, height, why) {
  const measurer = new ServerMeasurer(camera.name, width, height);
  showMode(measurer.mode + why);
  return measurer;
}
