// The first step: records are dropped, understood, looked at, and given a role in the identification.
import { remove } from "./api.js";
import { byId, errorPlace, h, keyed, say, show } from "./dom.js";
import { identifyForm } from "./identify.js";
import { inPage } from "./labels.js";
import { duration, range, short, whole } from "./numbers.js";
import { readingForm } from "./reading.js";
import { RecordFigure } from "./record_figure.js";
import { readyRecords, session, watch } from "./state.js";
import { onStep } from "./steps.js";
import { sendAll, sendExample } from "./upload.js";

// Colours of curves; their values are in app.css.
export const COLOURS = ["measured", "simulated", "rising", "falling", "third", "fourth"];

const roles = new Map(); // of a record on this page: "train", "validate" or "none"
const unseen = new Set(); // records that are not drawn
const lately = new Map(); // status of each record as last seen
export const roleOf = (id) => roles.get(id) ?? "train";
export const colourOf = (id) => COLOURS[Math.max(0, session.state.records.findIndex((one) => one.id === id)) % COLOURS.length];

let figure = null;
let problem = null;

export function buildRecords() {
  const panel = byId("records");
  const input = h("input", { type: "file", id: "file", multiple: true, class: "unseen" });
  input.addEventListener("change", () => {
    sendAll(input.files);
    input.value = "";
  });
  problem = errorPlace();
  figure = new RecordFigure();
  panel.append(
    h("h2", { class: "unseen" }, "Records"),
    h(
      "div",
      { class: "drop", id: "drop" },
      h("p", { class: "big" }, "Drop a record here"),
      h("p", {}, "A measurement of your actuator: time, voltage and displacement. CSV and other text, Excel, LabVIEW (LVM, TDMS), MATLAB, HDF5, NumPy, Parquet."),
      h("p", {}, "Units stand in the names of the columns:"),
      h("pre", {}, SAMPLE),
      h("p", { class: "row" }, input, h("label", { for: "file", class: "button main" }, "Choose a file"), h("button", { type: "button", id: "example", onclick: sendExample }, "Try with an example")),
      h("p", { class: "muted" }, "Files stay on this computer. The example is a record of a virtual actuator."),
    ),
    h("ul", { id: "uploads", class: "uploads" }),
    journey(),
    h(
      "div",
      { class: "split", id: "records-body", hidden: true },
      h("div", { class: "side" }, h("ul", { id: "record-list", class: "cards", "aria-label": "Records" }), problem, identifyForm()),
      h("div", { class: "stage" }, figure.element),
    ),
  );
  watch("state", refresh);
  onStep("records", () => figure.draw(seenRecords()));
}

const SAMPLE = "time_s,voltage_V,displacement_um\n0.000,0.00,0.01\n0.001,0.12,0.02";
const JOURNEY = [
  ["Record", "Play loops of several heights and write down time, voltage and displacement."],
  ["Identify", "One click. A first model exists within seconds; it comes with the error to expect, in words."],
  ["Trust", "See measured and simulated, what the records determine, and what to record next."],
  ["Voltage", "Draw a path or choose a scan: the voltage appears as you drag. Download it as CSV."],
  ["Use", "Play it on a rig from here, or export C, an FMU, WebAssembly or a wave table."],
];

const journey = () => h("ol", { class: "journey", id: "journey" }, JOURNEY.map(([title, text]) => h("li", {}, h("b", {}, title), text)));

const seenRecords = () => readyRecords().filter((one) => !unseen.has(one.id));

function refresh(state) {
  show(byId("records-body"), state.records.length > 0);
  show(byId("journey"), state.records.length === 0);
  byId("drop").classList.toggle("small", state.records.length > 0);
  const items = state.records.map((one) => ({ ...one, role: roleOf(one.id), seen: !unseen.has(one.id), colour: colourOf(one.id) }));
  // What is open comes first, the newest on top.
  const open = items.filter((one) => one.status !== "ready").reverse();
  const first = open.find((one) => one.status === "refused" && one.columns?.length)?.id;
  keyed(byId("record-list"), [...open, ...items.filter((one) => one.status === "ready")], { create: (one) => card(one, one.id === first) });
  for (const { id, status } of state.records) {
    if (status === "refused" && lately.get(id) === "reading") byId("record-list").querySelector(`[data-key="${id}"]`).scrollIntoView({ block: "nearest" });
    lately.set(id, status);
  }
  show(figure.element, readyRecords().length > 0);
  figure.draw(seenRecords());
}

function card(record, first) {
  const parts = { reading: readingCard, ready: readyCard, refused: refusedCard }[record.status](record, first);
  return h("li", { class: `card ${record.status}` }, parts);
}

const head = (record, ...more) =>
  h("div", { class: "card-head" }, h("i", { class: `swatch ${record.colour}` }), h("h3", {}, record.name), ...more, deleteButton(record));

function readingCard(record) {
  return [head(record), h("p", { class: "muted" }, "Reading\u2026"), h("progress", { "aria-label": `Reading ${record.name}` })];
}

// The form of the newest is open; without columns there is nothing to say but to try again.
function refusedCard(record, first) {
  const form = readingForm(record);
  return [
    head(record),
    h("p", { class: "error", role: "alert" }, inPage(record.error ?? "It could not be read.")),
    record.columns?.length ? h("details", { open: first }, h("summary", {}, "Say how to read it"), record.hint && h("p", {}, "The marked options may mend it."), form) : form,
  ];
}

function readyCard(record) {
  return [
    head(record),
    h(
      "dl",
      { class: "facts" },
      ...fact("Samples", `${whole(record.samples)} in ${duration(record.seconds)}, ${short(record.rate_hz, 4)} Hz`),
      ...fact("Voltage", range(record.voltage, "V")),
      ...fact("Displacement", range(record.displacement_um, "\u00b5m")),
    ),
    record.words?.length > 0 && h("details", {}, h("summary", {}, "How the file was understood"), h("ul", {}, record.words.map((one) => h("li", {}, one))), readingForm(record)),
    h(
      "div",
      { class: "row" },
      tick(record, "train", "Train", record.role === "train", (on) => roles.set(record.id, on ? "train" : "none")),
      tick(record, "validate", "Validate", record.role === "validate", (on) => roles.set(record.id, on ? "validate" : "none")),
      tick(record, "seen", "Draw", record.seen, (on) => (on ? unseen.delete(record.id) : unseen.add(record.id))),
    ),
  ];
}

export const fact = (name, value) => [h("dt", {}, name), h("dd", {}, value)];

function tick(record, name, label, checked, change) {
  const box = h("input", { type: "checkbox", checked, "data-name": `${record.id}-${name}`, "aria-label": `${label}: ${record.name}` });
  box.addEventListener("change", () => {
    change(box.checked);
    refresh(session.state);
    document.dispatchEvent(new Event("roles"));
  });
  return h("label", { class: "tick" }, box, label);
}

function deleteButton(record) {
  const drop = async () => {
    say(problem, "");
    try {
      await remove(`/api/records/${record.id}`);
    } catch (error) {
      say(problem, error.message);
    }
  };
  return h("button", { type: "button", class: "quiet", onclick: drop, "aria-label": `Remove ${record.name} from the list` }, "Remove");
}
