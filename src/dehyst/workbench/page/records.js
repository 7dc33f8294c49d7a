// The first step: the user drops records, checks how they were read, looks at them, and gives each a role.
import { DECLARED } from "./declared.js";
import { byId, h } from "./dom.js";
import { exciteCard } from "./excite.js";
import { COLOURS, Figure, MICROMETRES, SECONDS, VOLTS } from "./figure.js";
import { Form, card, facts, fold, list, tick } from "./forms.js";
import { duration, range, short, whole } from "./numbers.js";
import { readingForm } from "./reading.js";
import * as server from "./server.js";
import { openStep } from "./steps.js";

const { announce, button, problem, readyRecords, redraw, session } = server;
// These elements are in index.html.
const [drop, file, example] = ["drop", "file", "example"].map(byId);

const roles = new Map(); // chosen role of each record: "train", "validate" or "none"
let uploads = 0; // number of files that are being sent
// If there is a model, a new record has no role until the user chooses one.
const isOpenQuestion = ({ id }) =>
  !roles.has(id) && session.state.models.length > 0 &&
  !session.state.models.some((model) => [...model.train, ...model.validate].includes(id));
const roleOf = (record) => roles.get(record.id) ?? (record.usable && !isOpenQuestion(record) ? "train" : "none");
const colourOf = (id, axis = 0) =>
  COLOURS[(Math.max(0, session.state.records.findIndex((record) => record.id === id)) + axis) % COLOURS.length];

export function recordsView({ records }) {
  // Records that need help are first in the list, the newest of them on top.
  const open = records.filter((record) => record.status !== "ready").reverse();
  const first = open.find((record) => record.status === "refused" && record.file_columns?.length)?.id;
  const cards = [...open, ...readyRecords()].map((record) => recordCard(record, record.id === first));
  figure.draw(readyRecords());
  drop.classList.toggle("small", records.length > 0);
  return [
    exciteCard(session.state),
    drop,
    problem("upload"),
    uploads > 0 && h("p#uploads", { role: "status" }, "Sending\u2026"),
    records.length > 0 &&
      h("div#records-body.split", { key: "body" },
        h("div.side", h("ul#record-list.cards", { "aria-label": "Records" }, cards), identifyCard()),
        h("div.stage", readyRecords().length > 0 && figure.element),
      ),
  ];
}

export function sendAll(files) {
  openStep("records");
  // A refused file is first in the list.
  window.scrollTo({ top: 0, behavior: "instant" });
  server.complain("upload", "");
  for (const file of files) send(file);
}

file.onchange = () => {
  sendAll(file.files);
  file.value = "";
};
// The user may choose a file before this script is loaded.
setTimeout(() => file.files.length > 0 && file.onchange());
example.onclick = () =>
  server.example("virtual-loops.csv").then((made) => sendAll([made]), (error) => server.complain("upload", error.message));

async function send(file) {
  const { name } = file;
  uploads += 1;
  redraw();
  try {
    await server.upload(file);
    announce(`${name} was sent and is being read.`);
  } catch (error) {
    server.complain("upload", `${name} was not sent: ${error.message}`);
  }
  uploads -= 1;
  redraw();
}

function recordCard(record, first) {
  const { id, name, status, usable } = record;
  const swatch = h("i.swatch", { style: `background:var(--${colourOf(id)})` });
  const content = { reading: readingCard, ready: readyCard, refused: refusedCard }[status];
  return h("li", { class: `card ${usable ? status : "refused"}`, key: id, id: `record-${id}` },
    h("div.card-head", swatch, h("h3", name), server.removeButton("records", record)),
    problem(`records ${id}`),
    content(record, first),
  );
}

const readingCard = ({ name }) => [h("p.muted", "Reading\u2026"), h("progress", { "aria-label": `Reading ${name}` })];

// The form of the newest record is open. Without columns there is no form, only a button to try again.
function refusedCard(record, first) {
  const { error, file_columns: columns, id } = record;
  const again = () => server.readRecord(id, { columns: record.columns });
  return [
    h("p.error", { role: "alert" }, error ?? "It could not be read."),
    ...(columns?.length
      ? [h("details", { open: first }, h("summary", "Say how to read it"), readingForm(record))]
      : [button("Read again", `reading ${id}`, again, { class: "quiet" }), problem(`reading ${id}`)]),
  ];
}

function readyCard(record) {
  const { id, name, samples, seconds, rate_hz: rate, voltage, displacement_um: displacement } = record;
  const { words, problems, others } = record;
  const understood = words?.length > 0 || record.file_columns?.length > 0;
  const verify = () => server.readRecord(id, { verified: true });
  const role = (label, own) => {
    const onchange = (event) => {
      roles.set(id, event.target.checked ? own : "none");
      redraw();
    };
    return tick(label, { type: "checkbox", checked: roleOf(record) === own, spoken: `${label}: ${name}`, onchange });
  };
  return [
    facts([
      ["Samples", `${whole(samples)} in ${duration(seconds)}, ${short(rate, 4)} Hz`],
      ["Voltage", range(voltage, "V")],
      ["Displacement", range(displacement, "\u00b5m")],
      ...Object.entries(others).map(([column, ends]) => [column, range(ends, "")]),
      ["Coupled axes", record.axes.join(", ") || undefined],
    ]),
    list(problems, "remarks"),
    record.columns.includes("?") && button("Verified", `verified ${id}`, verify, { "aria-label": `Verified: ${name}` }),
    problem(`verified ${id}`),
    understood && fold("How the file was understood", list(words), readingForm(record)),
    isOpenQuestion(record) && h("p", "What is it for?"),
    h("div.row",
      role("Train", "train"),
      role("Validate", "validate"),
      server.chosenModel() && isOpenQuestion(record) && checkButton(record),
    ),
  ];
}

function checkButton({ id, name }) {
  const check = async () => {
    roles.set(id, "none");
    await server.workOn(server.chosenModel().id, "check", { record: id }, "The check has begun.");
    openStep("model", { focus: true });
  };
  return button("Check the model", `records ${id}`, check, { class: "quiet", "aria-label": `Check the model by ${name}` });
}

const form = new Form("identify", DECLARED.forms.identify);

const withRole = (role) => readyRecords().filter((record) => roleOf(record) === role);

function identifyCard() {
  const [train, validate] = [withRole("train"), withRole("validate")];
  const names = (records) => records.map((record) => record.name).join(", ");
  let words = readyRecords().length ? "Mark a record to train with." : "A record has to be ready first.";
  const held = validate.length ? `; validates with ${names(validate)}` : "";
  if (train.length) words = `Trains with ${names(train)}${held}.`;
  const about = { class: "main wide-button", id: "identify", "aria-describedby": "identify-words" };
  return card("Identify", { class: "identify" },
    h("p#identify-words.muted", words),
    button("Identify a model", "identify", start, train.length ? about : { ...about, disabled: true }),
    problem("identify"),
    fold("Options", Object.keys(form.fields).map((name) => form.field(name))),
  );
}

async function start() {
  const options = form.collected();
  const ids = (role) => withRole(role).map((record) => record.id);
  const { id } = await server.identify({ train: ids("train"), validate: ids("validate"), options });
  announce("The identification has begun.");
  server.chooseModel(id);
  openStep("model");
  byId("main").focus({ preventScroll: true });
}

const VIEWS = {
  loops: { x: VOLTS, y: MICROMETRES, columns: ["voltage", "displacement"] },
  time: { x: SECONDS, y: MICROMETRES, columns: ["time", "displacement"] },
  voltage: { x: SECONDS, y: VOLTS, columns: ["time", "voltage"] },
};

class RecordFigure extends Figure {
  constructor() {
    const views = [["loops", "Loops"], ["time", "Displacement over time"], ["voltage", "Voltage over time"]];
    super({ title: "What was measured", views, choose: () => this.draw(this.records), tall: true });
  }

  // Draw these records, unless they are drawn already.
  async draw(records) {
    this.records = records;
    const version = (record) => `${record.columns} ${record.samples}`;
    const stamp = `${this.view} ${records.map((record) => `${record.id}:${version(record)}`).join(" ")}`;
    if (stamp === this.stamp) return;
    this.stamp = stamp;
    const { x, y, columns } = VIEWS[this.view];
    try {
      const ofAxis = (record) => (axis, k) => ({ ...record, axis, colour: colourOf(record.id, k) });
      const parts = records.flatMap((record) => (record.axes.length ? record.axes : [""]).map(ofAxis(record)));
      const data = await Promise.all(parts.map((part) => server.recordColumns(part, version(part), part.axis)));
      if (this.stamp !== stamp) return;
      const series = parts.map(({ id, name, axis, colour }, k) => {
        const [x, y] = columns.map((column) => data[k][column]);
        const title = axis ? `${name}, ${axis}` : name;
        return { key: `${id} ${axis}`, name: title, colour, x, y, rising: columns[0] === "time" };
      });
      const names = records.map((record) => `${record.name}, ${whole(record.samples)} samples`).join("; ");
      this.set({ x, y, series }, { spoken: `${y.label} over ${x.label.toLowerCase()} of ${names}.` });
    } catch (error) {
      this.stamp = null;
      this.output.textContent = error.message;
    }
  }
}
const figure = new RecordFigure();
