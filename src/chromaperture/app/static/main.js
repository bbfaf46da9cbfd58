// Tabs, and the start of everything.
import { attempt, say } from "./api.js";
import { loadCameras, startCameras } from "./cameras.js";
import { startAssistant } from "./assistant.js";
import { startLive, stop as stopLive } from "./live.js";
import { startPhoto } from "./photo.js";
import { startWatch } from "./watch.js";

const tabs = [...document.querySelectorAll("[role=tab]")];

function open(tab) {
  for (const one of tabs) {
    const chosen = one === tab;
    one.setAttribute("aria-selected", String(chosen));
    one.tabIndex = chosen ? 0 : -1;
    document.getElementById(one.getAttribute("aria-controls")).hidden = !chosen;
  }
  if (tab.id !== "tab-live") stopLive();
  say("");
  history.replaceState(null, "", `#${tab.getAttribute("aria-controls")}`);
  document.getElementById("measuring").hidden = tab.id === "tab-calibrate";
  document.dispatchEvent(new CustomEvent("tab", { detail: tab.getAttribute("aria-controls") }));
}

for (const [i, tab] of tabs.entries()) {
  tab.addEventListener("click", () => open(tab));
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = tabs[(i + step + tabs.length) % tabs.length];
    open(next);
    next.focus();
  });
}

if ("live" in document.documentElement.dataset) {  // of `chromaperture live`, which measures by itself, with one camera
  attempt(startWatch);
} else {
  startCameras();
  startLive();
  startPhoto();
  startAssistant();
  const wanted = tabs.find((tab) => `#${tab.getAttribute("aria-controls")}` === location.hash);
  if (wanted) open(wanted);
  attempt(() => loadCameras());
  if ("serviceWorker" in navigator) navigator.serviceWorker.register("sw.js").catch((error) => console.info("not kept for offline use:", error.message));
}
