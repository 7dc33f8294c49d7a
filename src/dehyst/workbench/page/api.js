// All requests to the server of this page. An error is an Error with the server's sentence.

async function request(path, options) {
  let response;
  try {
    response = await fetch(path, { cache: "no-store", ...options });
  } catch {
    throw new Error("The server does not answer. Is `dehyst workbench` still running in its terminal?");
  }
  if (response.ok) return response;
  const body = await response.json().catch(() => ({}));
  throw new Error(body.error ?? `The server answered with status ${response.status} ${response.statusText}.`);
}

const getBuffer = async (path) => (await request(path)).arrayBuffer();

async function post(path, body = {}) {
  const headers = { "Content-Type": "application/json" };
  const response = await request(path, { method: "POST", headers, body: JSON.stringify(body) });
  const text = await response.text();
  return text ? JSON.parse(text) : {};
}

export const readRecord = (id, options) => post(`/api/records/${id}/read`, { options });
export const identify = (body) => post("/api/models", body);
export const endIdentification = (id) => post(`/api/models/${id}/end`);
// "insight", "check", "update", "path" or "export": a job on a model.
export const workOn = (id, what, body) => post(`/api/models/${id}/${what}`, body);
export const cancelJob = (id) => post(`/api/jobs/${id}/cancel`);
// Take a record or a model ("records", "models") from the list.
export const remove = (kind, id) => request(`/api/${kind}/${id}`, { method: "DELETE" });
export const rig = (what, body) => post(`/api/rig/${what}`, body);

export const wasmAddress = (model, period) => `/api/models/${model.id}/wasm?period=${period}`;
export const fileAddress = (path) => `/files/${path.split("/").map(encodeURIComponent).join("/")}`;
export const textOfFile = async (path) => (await request(fileAddress(path))).text();
export const example = async (name) => new File([await getBuffer(`/page/${name}`)], name);

// News of the server; both ends of a WebSocket.
export const events = (location) =>
  new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/events`);

// Send a file as it is; `progress` is called with the share that was sent.
export function upload(file, progress) {
  return new Promise((resolve, reject) => {
    const sending = new XMLHttpRequest();
    sending.open("PUT", `/api/records?name=${encodeURIComponent(file.name)}`);
    sending.responseType = "json";
    sending.upload.onprogress = (event) => progress(event.total ? event.loaded / event.total : 0);
    sending.onerror = () => reject(new Error("The server does not answer; the file was not sent."));
    sending.onload = () => {
      if (sending.status < 300) resolve(sending.response);
      else reject(new Error(sending.response?.error ?? `The server answered with status ${sending.status}.`));
    };
    sending.send(file);
  });
}

// What `create` promises, once a key; the last few are kept, and none that failed.
export function remembered(kept, key, create, most = 12) {
  const found = kept.get(key) ?? create();
  kept.delete(key);
  kept.set(key, found);
  found.catch(() => kept.delete(key));
  if (kept.size > most) kept.delete(kept.keys().next().value);
  return found;
}

// Columns of equal length, little-endian 32-bit floats, by path and version.
const columns = new Map();

function getColumns(path, count, version = "") {
  const split = (buffer) => {
    const length = Math.floor(buffer.byteLength / (4 * count));
    return Array.from({ length: count }, (_, k) => new Float32Array(buffer, 4 * k * length, length));
  };
  return remembered(columns, `${path} ${version}`, () => getBuffer(path).then(split));
}

export async function recordColumns(record, version, axis) {
  const query = axis ? `?axis=${encodeURIComponent(axis)}` : "";
  const [time, voltage, displacement] = await getColumns(`/api/records/${record.id}/data${query}`, 3, version);
  return { time, voltage, displacement };
}

export async function voltageColumns({ id }, axis) {
  const [time, voltage] = await getColumns(`/api/voltages/${id}/data?axis=${encodeURIComponent(axis)}`, 4);
  return { time, voltage };
}

export async function scanColumns(scan) {
  const [time, wanted] = await getColumns(`/api/scan?of=${encodeURIComponent(JSON.stringify(scan))}`, 2);
  return { time, wanted };
}


// Request a stop of the server and of the process that drives the rig; the answers to come, of either.
export function stopRequests(emergency, patience) {
  const options = { method: "POST", signal: AbortSignal.timeout(patience) };
  const json = { headers: { "Content-Type": "application/json" }, body: "{}" };
  const ways = [["the server", fetch("/api/rig/stop", { ...options, ...json })]];
  if (emergency) {
    const headers = { "X-Dehyst-Stop": emergency.key };
    const address = `http://127.0.0.1:${emergency.port}/stop`;
    ways.unshift(["the rig's own process", fetch(address, { ...options, headers, keepalive: true })]);
  }
  return ways;
}
