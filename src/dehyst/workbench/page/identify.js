// The form that starts an identification.
import { announce, button, problem } from "./acts.js";
import { identify } from "./api.js";
import { byId, h } from "./dom.js";
import { Form, card, fold } from "./forms.js";
import { LABELS } from "./labels.js";
import { roleOf } from "./records.js";
import { chooseModel, readyRecords } from "./state.js";
import { openStep } from "./steps.js";

const STRUCTURES = [
  ["auto", "Automatic: select the parts by cross-validation"],
  ["maxwell_slip", "Maxwell-slip: slip elements and a spring (seconds)"],
];
const NORMS = [["l1", "Sum of absolute errors (robust)"], ["l2", "Sum of squares"], ["linf", "Largest error"]];
const NUMBERS = {
  goal: { above: 0, value: "1", unit: "% of the stroke", hint: "With an error below it the model is ready for use." },
  time_limit: { above: 0, unit: "s", placeholder: "none", hint: "Then the best model so far is completed." },
  sensor_lag: { least: 0, unit: "s", placeholder: "unknown", hint: "Time constant of its filter; 0 if it has none." },
};
const numbers = Object.entries(NUMBERS).map(([name, one]) => [name, { label: LABELS[name], optional: true, ...one }]);
const form = new Form("identify", {
  structure: { label: LABELS.structure, choices: STRUCTURES, value: "auto" },
  ...Object.fromEntries(numbers),
  norm: { label: LABELS.norm, choices: NORMS, value: "l1" },
  name: { label: "Name of the model", placeholder: "of the first record" },
});

const withRole = (role) => readyRecords().filter((one) => roleOf(one) === role);

export function identifyCard() {
  const [train, validate] = [withRole("train"), withRole("validate")];
  const names = (records) => records.map((one) => one.name).join(", ");
  let words = readyRecords().length ? "Mark a record to train with." : "A record has to be ready first.";
  const held = validate.length ? `; validates with ${names(validate)}` : "";
  if (train.length) words = `Trains with ${names(train)}${held}.`;
  const about = { class: "main wide-button", id: "identify", "aria-describedby": "identify-words" };
  return card(
    "Identify",
    { class: "identify" },
    h("p#identify-words.muted", words),
    button("Identify a model", "identify", start, train.length ? about : { ...about, disabled: true }),
    problem("identify"),
    fold("Options", Object.keys(form.fields).map((name) => form.field(name))),
  );
}

async function start() {
  const { structure, norm, name } = form.values;
  const options = { structure, norm };
  for (const number of Object.keys(NUMBERS)) {
    const value = form.number(number);
    if (value !== null) options[number] = value;
  }
  if (name.trim()) options.name = name.trim();
  const ids = (role) => withRole(role).map((one) => one.id);
  const { id } = await identify({ train: ids("train"), validate: ids("validate"), options });
  announce("The identification has begun.");
  chooseModel(id);
  openStep("model");
  byId("main").focus({ preventScroll: true });
}
