// The state that the server holds, as this page last heard it. Views subscribe; nothing here draws.

const NOTHING = { records: [], models: [], voltages: [], jobs: [], files: [], rig: { status: "none" }, log: [] };
const FIRST_WAIT = 300;
const LONGEST_WAIT = 5000;

export const session = { state: NOTHING, connected: false };

const watchers = { state: [], live: [], connection: [] };
let socket = null;
let wait = FIRST_WAIT;

// Call `watcher` with each new state, live message or change of the connection.
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

export function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/events`);
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
  tell("connection", connected);
}

// The rig's watchdog waits for an answer to each of these: it comes before anything is drawn.
function receive(message) {
  if (message.kind === "live" || message.kind === "ping") {
    if (socket.readyState === WebSocket.OPEN) socket.send('{"kind":"alive"}');
  }
  if (message.kind === "live") tell("live", message);
  if (message.kind === "state") receiveState(message.state);
}

export function receiveState(state) {
  session.state = { ...NOTHING, ...state, rig: state.rig ?? NOTHING.rig };
  tell("state", session.state);
}

const among = (items, id) => items.find((one) => one.id === id);
export const recordOf = (id) => among(session.state.records, id);
export const modelOf = (id) => among(session.state.models, id);
export const readyModels = () => session.state.models.filter((one) => one.status === "ready");
export const readyRecords = () => session.state.records.filter((one) => one.status === "ready");
export const jobsOf = (subject, kind) =>
  session.state.jobs.filter((one) => one.subject === subject && (kind === undefined || one.kind === kind));

// What this page alone knows: which model the person looks at. It survives a reload, and is no secret.
const CHOSEN = "dehyst-model";

export function chosenModel() {
  const ready = readyModels();
  const id = sessionStorage.getItem(CHOSEN);
  return ready.find((one) => one.id === id) ?? ready.at(-1) ?? null;
}

export const rememberModel = (id) => sessionStorage.setItem(CHOSEN, id);

export function chooseModel(id) {
  rememberModel(id);
  tell("state", session.state);
}
