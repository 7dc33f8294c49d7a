// Requests to the server of this page, the last state that it sent, and buttons with their errors.
import { byId, h } from "./dom.js";

async function request(path, options) {
  const gone = () => {
    throw new Error("The server does not answer. Is `dehyst workbench` still running in its terminal?");
  };
  const response = await fetch(path, { cache: "no-store", ...options }).catch(gone);
  if (response.ok) return response;
  const body = await response.json().catch(() => ({}));
  throw new Error(body.error ?? `The server answered with status ${response.status} ${response.statusText}.`);
}

const getBuffer = async (path) => (await request(path)).arrayBuffer();
const TYPE = { "Content-Type": "application/json" };
const post = async (path, body = {}) =>
  (await request(path, { method: "POST", headers: TYPE, body: JSON.stringify(body) })).json();

export const excite = (body) => post("/api/excitations", body);
// The body is { columns }, { form } with the values of the form, or { verified }.
export const readRecord = (id, body) => post(`/api/records/${id}/read`, body);
export const identify = (body) => post("/api/models", body);
// Starts a job with a model ("insight", "check", "update", "follow", "export"), or ends its identification ("end").
export const workOn = (id, what, body, words = "") =>
  post(`/api/models/${id}/${what}`, body).then(() => announce(words));
export const cancelJob = (id) => post(`/api/jobs/${id}/end`);

export const wasmAddress = (model, period) => `/api/models/${model.id}/wasm?period=${period}`;
export const fileAddress = (path) => `/files/${path.split("/").map(encodeURIComponent).join("/")}`;
export const textOfFile = async (path) => (await request(fileAddress(path))).text();
export const example = async (name) => new File([await getBuffer(`/page/${name}`)], name);

// The points (s, um) of each axis of a model, from a file of any format of records.
export async function readPath({ id }, file) {
  const path = `/api/models/${id}/points?name=${encodeURIComponent(file.name)}`;
  return (await (await request(path, { method: "PUT", body: file })).json()).points;
}

export const upload = (file) =>
  request(`/api/records?name=${encodeURIComponent(file.name)}`, { method: "PUT", body: file });

// The result of `create`, a Promise that is made once for a key. The last ones are kept, but not those that failed.
export function remembered(kept, key, create, most = 12) {
  const found = kept.get(key) ?? create();
  kept.delete(key);
  kept.set(key, found);
  found.catch(() => kept.delete(key));
  if (kept.size > most) kept.delete(kept.keys().next().value);
  return found;
}

// Columns by path and version. They have equal length, and are sent as little-endian 32-bit floats.
const columns = new Map();

function getColumns(path, names, version = "") {
  const split = (buffer) => {
    const length = Math.floor(buffer.byteLength / (4 * names.length));
    return Object.fromEntries(names.map((name, k) => [name, new Float32Array(buffer, 4 * k * length, length)]));
  };
  return remembered(columns, `${path} ${version}`, () => getBuffer(path).then(split));
}

export const recordColumns = ({ id }, version, axis) =>
  getColumns(`/api/records/${id}/data?axis=${encodeURIComponent(axis)}`, ["time", "voltage", "displacement"], version);

export const scanColumns = (scan) =>
  getColumns(`/api/scan?of=${encodeURIComponent(JSON.stringify(scan))}`, ["time", "wanted"]);

// The last state that the server sent. Views watch it.
const NOTHING = { excitations: [], records: [], models: [], voltages: [], jobs: [], files: [], log: [] };
export const session = { state: NOTHING, connected: false };
const watchers = [];

// Call `watcher` with the state whenever it may have changed.
export const watch = (watcher) => watchers.push(watcher);

function tell() {
  for (const watcher of watchers) {
    try {
      watcher(session.state);
    } catch (error) {
      console.error(error);
    }
  }
}

// Draw again soon, after a change of values that only this page has.
let asked;
export function redraw() {
  asked ??= setTimeout(() => {
    asked = undefined;
    tell();
  });
}

const AGAIN = 1000; // milliseconds until the server is tried again

export function connect() {
  const socket = new WebSocket(`ws://${location.host}/api/events`);
  socket.onopen = () => linked(true);
  socket.onmessage = ({ data }) => {
    session.state = { ...NOTHING, ...JSON.parse(data) };
    tell();
  };
  socket.onclose = () => {
    linked(false);
    setTimeout(connect, AGAIN);
  };
}

function linked(connected) {
  session.connected = connected;
  redraw();
}

const among = (items, id) => items.find((item) => item.id === id);
export const recordOf = (id) => among(session.state.records, id);
export const modelOf = (id) => among(session.state.models, id);
export const readyModels = () => session.state.models.filter((model) => model.status === "ready");
export const readyRecords = () => session.state.records.filter((record) => record.status === "ready");
// The jobs of a kind that are shown: running jobs, and the last one if it failed.
export function openJobs(kind, subject) {
  const all = session.state.jobs.filter((job) => job.kind === kind && (!subject || job.subject === subject));
  return all.filter((job, k) => job.status === "running" || (job.status === "failed" && k === all.length - 1));
}

// The model on the page: the newest, unless the user chose another. A reload of the page keeps the choice.
const CHOSEN = "dehyst-model";
export const chosenModel = () =>
  among(readyModels(), sessionStorage.getItem(CHOSEN)) ?? readyModels().at(-1) ?? null;

export function chooseModel(id) {
  sessionStorage.setItem(CHOSEN, id);
  redraw();
}

// Errors by the place where they are shown, and buttons whose work is running.
const problems = new Map();
const busy = new Set();

export const problem = (place) =>
  problems.get(place) && h("p.error", { role: "alert", key: `problem ${place}` }, problems.get(place));

export function complain(place, sentence) {
  if ((problems.get(place) ?? "") === sentence) return;
  problems.set(place, sentence);
  redraw();
}

// A button is disabled while its work runs; an error is shown at `place`.
export function button(text, place, work, properties = {}) {
  const key = `${place} ${text}`;
  const onclick = async () => {
    busy.add(key);
    complain(place, "");
    redraw();
    try {
      await work();
    } catch (error) {
      complain(place, error.message);
    }
    busy.delete(key);
    redraw();
  };
  return h("button", { type: "button", disabled: busy.has(key), onclick, ...properties }, text);
}

// A button that removes an entry from the list of a kind, such as "records"; its error is shown at `KIND ID`.
export const removeButton = (kind, { id, name }) =>
  button("Remove", `${kind} ${id}`, () => request(`/api/${kind}/${id}`, { method: "DELETE" }), {
    class: "quiet",
    "aria-label": `Remove ${name} from the list`,
  });

// Text for screen readers only.
export function announce(text) {
  byId("announcer").textContent = text;
}
