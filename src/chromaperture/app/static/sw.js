// Keeps the page, so that it opens without the computer that serves it. Answers of the server are never kept.
const NAME = "chromaperture-page";
const FILES = [
  "./", "app.css", "api.js", "assistant.js", "cameras.js", "capture.js", "charts.js", "frame.js", "live.js", "main.js",
  "manifest.webmanifest", "measurers.js", "photo.js", "photo_file.js", "plan.js", "points.js", "sources.js", "store.js", "tiff.js", "video_planes.js", "viewer.js", "watch.js", "webgpu.js", "icon-192.png", "icon-512.png", "icon-maskable-512.png",
];

self.addEventListener("install", (event) => {
  event.waitUntil(caches.open(NAME).then((cache) => cache.addAll(FILES)).then(() => self.skipWaiting()));
});

self.addEventListener("activate", (event) => event.waitUntil(self.clients.claim()));

self.addEventListener("fetch", (event) => {
  const inner = new URL(event.request.url).pathname.slice(new URL(self.registration.scope).pathname.length);
  if (event.request.method !== "GET" || inner.startsWith("api/")) return;
  event.respondWith(newest(event.request));
});

const PATIENCE_MS = 3000;  // chosen by hand: an address that has gone from the network answers nothing for minutes

// The server's file where it answers, so that nothing gets old; the kept one where it does not.
async function newest(request) {
  const cache = await caches.open(NAME), kept = await cache.match(request, { ignoreSearch: true });
  try {
    const answer = await fetch(request, kept ? { signal: AbortSignal.timeout(PATIENCE_MS) } : {});
    if (answer.ok) await cache.put(request, answer.clone()).catch(() => {});
    return answer;
  } catch (error) {
    if (kept) return kept;
    throw error;
  }
}
