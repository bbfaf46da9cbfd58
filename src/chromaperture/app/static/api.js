// Requests to the server that served this page. Whatever goes wrong is one sentence.

export class Sentence extends Error {}

export const MOST_BYTES = 256 * 2 ** 20;  // of a file, as the server takes; it cuts larger ones off

const NO_ANSWER = "The computer that measures does not answer. Start “chromaperture serve” there, in the same network; nothing here is lost.";

export async function ask(path, options = {}) {
  if (options.body?.size > MOST_BYTES) throw new Sentence("This file is larger than 256 MB. Choose a smaller one.");
  let answer;
  try {
    answer = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw Object.assign(new Sentence(NO_ANSWER), { isNoAnswer: true });
  }
  if (answer.ok) return answer;
  const text = await answer.text();
  let line = text.trim();
  try { line = JSON.parse(text).error ?? line; } catch { /* a line already */ }
  const said = line ? line[0].toUpperCase() + line.slice(1) + (/[.!?]$/.test(line) ? "" : ".") : `The computer answers with error ${answer.status}.`;
  throw Object.assign(new Sentence(said), { status: answer.status });
}

export const askJson = async (path, options) => (await ask(path, options)).json();

export const query = (values) => "?" + new URLSearchParams(Object.entries(values).filter(([, v]) => v !== undefined && v !== null && v !== ""));

// ---- the line of messages

const line = () => document.getElementById("message");

export function say(text, { plain = false } = {}) {
  line().textContent = text;
  line().classList.toggle("plain", plain);
  line().hidden = !text;
}

// Runs a task of a button; its failure is said, whatever it is.
export async function attempt(task) {
  try {
    return await task();
  } catch (error) {
    if (error.name !== "AbortError") say(error instanceof Sentence ? error.message : `Something unexpected: ${error.message || error.name}. Reload the page.`);
    if (!(error instanceof Sentence)) console.error(error);
    return undefined;
  }
}

export function make(tag, values = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(values)) {
    if (name === "text") element.textContent = value;
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== undefined && value !== null) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}
