// A camera that the computer itself holds: its pictures come from the server, and photographs are taken there.
import { ask, attempt, make, query } from "./api.js";

const PAUSE_MS = 250;  // between two pictures of a live camera, beside the time that they take

export class ComputerCamera {
  constructor(number, { name, live }) {
    Object.assign(this, { number, name, live, open: true, failed: false });
    this.picture = make("img", { alt: `Picture of ${name}` });
  }

  // Shows the next picture. One that cannot be had is said, and the one before stays.
  async next() {
    const answer = await ask(`api/sources/${this.number}/picture${query({ at: Date.now() })}`);
    const url = URL.createObjectURL(await answer.blob());
    if (!this.open) return URL.revokeObjectURL(url);
    const old = this.picture.src;
    this.picture.src = url;
    await this.picture.decode().catch(() => {});
    if (old) URL.revokeObjectURL(old);
    return undefined;
  }

  // Shows pictures of a live camera until it is closed; after a failure `again` is offered.
  async play(again) {
    this.failed = false;
    while (this.open && !this.failed) {
      if (!document.hidden) {
        this.failed = true;
        await attempt(async () => { await this.next(); this.failed = false; });
      }
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    }
    if (this.open) again();
  }

  close() {
    this.open = false;
    if (this.picture.src) URL.revokeObjectURL(this.picture.src);
    fetch(`api/sources/${this.number}`, { method: "DELETE" }).catch(() => {});  // it would be released by itself
  }
}
