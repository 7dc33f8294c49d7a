// The state that the server holds, as this page last heard it. Views subscribe; nothing here draws.
import { events } from "./api.js";

const NOTHING = { records: [], models: [], voltages: [], jobs: [], files: [], rig: { status: "none" }, log: [] };
const FIRST_WAIT = 300;
const LONGEST_WAIT = 5000;

export const session = { state: NOTHING, connected: false };

const watchers = { state: [], live: [] };
let socket = null;
let wait = FIRST_WAIT;

// Call `watcher` with each new state, which may have to be drawn anew, or with each live message.
export const watch = (kind, watcher) => watchers[kind].push(watcher);

const tell = (kind, value) => {
  for (const watcher of watchers[kind]) {
    try {
      watcher(value);
    } catch (error) {
      console.error(error);
    }
  }
};

// Draw anew soon: what this page alone knows has changed.
let asked;
export function redraw() {
  asked ??= setTimeout(() => {
    asked = undefined;
    tell("state", session.state);
  });
}

export function connect() {
  socket = events(location);
  socket.addEventListener("open", () => {
    wait = FIRST_WAIT;
    linked(true);
  });
  socket.addEventListener("message", (event) => receive(JSON.parse(event.data)));
  socket.addEventListener("close", () => {
    linked(false);
    setTimeout(connect, wait);
    wait = Math.min(2 * wait, LONGEST_WAIT);
  });
}

function linked(connected) {
  if (session.connected === connected) return;
  session.connected = connected;
  redraw();
}

// The rig's watchdog waits for an answer to each of these: it comes before anything is drawn.
function receive(message) {
  if (message.kind === "live" || message.kind === "ping") {
    if (socket.readyState === WebSocket.OPEN) socket.send('{"kind":"alive"}');
  }
  if (message.kind === "live") tell("live", message);
  if (message.kind === "state") {
    session.state = { ...NOTHING, ...message.state, rig: message.state.rig ?? NOTHING.rig };
    tell("state", session.state);
  }
}

const among = (items, id) => items.find((one) => one.id === id);
export const recordOf = (id) => among(session.state.records, id);
export const modelOf = (id) => among(session.state.models, id);
export const readyModels = () => session.state.models.filter((one) => one.status === "ready");
export const readyRecords = () => session.state.records.filter((one) => one.status === "ready");
// The jobs of a kind that are to be shown: those that run, and the last one if it failed.
export function openJobs(kind, subject) {
  const all = session.state.jobs.filter((one) => one.kind === kind && (!subject || one.subject === subject));
  return all.filter((one, k) => one.status === "running" || (one.status === "failed" && k === all.length - 1));
}

// What this page alone knows: which model the person looks at. It survives a reload, and is no secret.
const CHOSEN = "dehyst-model";

export function chosenModel() {
  const ready = readyModels();
  return among(ready, sessionStorage.getItem(CHOSEN)) ?? ready.at(-1) ?? null;
}

export function chooseModel(id) {
  sessionStorage.setItem(CHOSEN, id);
  redraw();
}
