// Camera files that stay on this device, in the browser's own database.
import { Sentence } from "./api.js";

function open() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open("chromaperture", 1);
    request.onupgradeneeded = () => request.result.createObjectStore("cameras", { keyPath: "name" });
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(new Sentence("This browser keeps nothing for this page (a private window?). The camera file is still on the computer; save it as a file."));
  });
}

async function run(mode, task) {
  const base = await open();
  try {
    return await new Promise((resolve, reject) => {
      const transaction = base.transaction("cameras", mode);
      const request = task(transaction.objectStore("cameras"));
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

export const keepCamera = (name, data) => run("readwrite", (cameras) => cameras.put({ name, data, kept: Date.now() }));
export const keptCameras = () => run("readonly", (cameras) => cameras.getAll());
export const forgetCamera = (name) => run("readwrite", (cameras) => cameras.delete(name));
