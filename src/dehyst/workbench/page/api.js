// Requests to the server of this page. An error is an Error with the server's sentence.

async function answer(response) {
  if (response.ok) return response;
  let sentence = `The server answered with status ${response.status} ${response.statusText}.`;
  try {
    sentence = (await response.json()).error ?? sentence;
  } catch {
    // not JSON: the status has to do
  }
  throw new Error(sentence);
}

async function request(path, options) {
  let response;
  try {
    response = await fetch(path, { cache: "no-store", ...options });
  } catch {
    throw new Error("The server does not answer. Is `dehyst workbench` still running in its terminal?");
  }
  return answer(response);
}

export const getJson = async (path) => (await request(path)).json();
export const getBuffer = async (path) => (await request(path)).arrayBuffer();

export async function post(path, body = {}) {
  const response = await request(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  });
  const text = await response.text();
  return text ? JSON.parse(text) : {};
}

export const remove = (path) => request(path, { method: "DELETE" });

// Send a file as it is; `progress` is called with the share that was sent.
export function upload(path, file, progress) {
  return new Promise((resolve, reject) => {
    const sending = new XMLHttpRequest();
    sending.open("PUT", path);
    sending.upload.addEventListener("progress", (event) => progress(event.total ? event.loaded / event.total : 0));
    sending.addEventListener("error", () => reject(new Error("The server does not answer; the file was not sent.")));
    sending.addEventListener("load", () => {
      let body = {};
      try {
        body = JSON.parse(sending.responseText);
      } catch {
        // not JSON: the status has to do
      }
      if (sending.status < 300) resolve(body);
      else reject(new Error(body.error ?? `The server answered with status ${sending.status}.`));
    });
    sending.send(file);
  });
}

// A buffer of little-endian 32-bit floats as that many columns of equal length.
export function columns(buffer, count) {
  const length = Math.floor(buffer.byteLength / (4 * count));
  return Array.from({ length: count }, (_, k) => new Float32Array(buffer, 4 * k * length, length));
}

// Columns by path and version; the last few are kept.
const kept = new Map();
const MOST_KEPT = 12;

export function getColumns(path, count, version = "") {
  const key = `${path} ${version}`;
  const known = kept.get(key);
  kept.delete(key);
  const found = known ?? getBuffer(path).then((buffer) => columns(buffer, count));
  kept.set(key, found);
  found.catch(() => kept.delete(key));
  if (kept.size > MOST_KEPT) kept.delete(kept.keys().next().value);
  return found;
}
