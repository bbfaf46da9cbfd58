// Camera files and plans that stay on this device, in the browser's own database.
import { Sentence } from "./api.js";

function open() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open("chromaperture", 2);
    request.onupgradeneeded = ({ oldVersion }) => {
      if (oldVersion < 1) request.result.createObjectStore("cameras", { keyPath: "name" });
      request.result.createObjectStore("plans", { keyPath: "key" });
    };
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(new Sentence("This browser keeps nothing for this page (a private window?). The camera file is still on the computer; save it as a file."));
  });
}

async function run(store, mode, task) {
  const base = await open();
  try {
    return await new Promise((resolve, reject) => {
      const transaction = base.transaction(store, mode);
      const request = task(transaction.objectStore(store));
      transaction.oncomplete = () => resolve(request.result);
      transaction.onerror = transaction.onabort = () => reject(transaction.error ?? request.error);
    });
  } catch (error) {
    if (error?.name === "QuotaExceededError") throw new Sentence("The storage of this browser is full: the camera file was not kept here. Free some space on the device; it is still on the computer.");
    throw error;
  } finally {
    base.close();
  }
}

export const keepCamera = (name, data) => run("cameras", "readwrite", (cameras) => cameras.put({ name, data, kept: Date.now() }));
export const keptCameras = () => run("cameras", "readonly", (cameras) => cameras.getAll());
export async function forgetCamera(name) {
  await run("cameras", "readwrite", (cameras) => cameras.delete(name));
  for (const plan of await keptPlans()) if (plan.name === name) await run("plans", "readwrite", (plans) => plans.delete(plan.key));
}

const MOST_PLANS = 8;  // of 2.4 MB for 720 x 480; the oldest go

export const keptPlans = () => run("plans", "readonly", (plans) => plans.getAll());
export async function keepPlan(plan) {
  await run("plans", "readwrite", (plans) => plans.put({ ...plan, kept: Date.now() }));
  const old = (await keptPlans()).sort((a, b) => b.kept - a.kept).slice(MOST_PLANS);
  for (const { key } of old) await run("plans", "readwrite", (plans) => plans.delete(key));
}
