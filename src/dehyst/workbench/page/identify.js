// The form that starts an identification.
import { post } from "./api.js";
import { action, announce, byId, choice, errorPlace, field, h, number, say } from "./dom.js";
import { LABELS } from "./labels.js";
import { parsed } from "./numbers.js";
import { roleOf } from "./records.js";
import { chooseModel, readyRecords, watch } from "./state.js";
import { openStep } from "./steps.js";

const STRUCTURES = [
  ["auto", "Automatic: select the parts by cross-validation"],
  ["maxwell_slip", "Maxwell-slip: slip elements and a spring (seconds)"],
];
const NORMS = [
  ["l1", "Sum of absolute errors (robust)"],
  ["l2", "Sum of squares"],
  ["linf", "Largest error"],
];

let inputs = null;
let sentence = null;
let button = null;

export function identifyForm() {
  inputs = {
    structure: choice(STRUCTURES, "auto"),
    goal: number({ value: "1" }),
    time_limit: number({ placeholder: "none" }),
    sensor_lag: number({ placeholder: "unknown" }),
    norm: choice(NORMS, "l1"),
    name: h("input", { type: "text", autocomplete: "off", placeholder: "of the first record", maxlength: "60" }),
  };
  sentence = h("p", { class: "muted", id: "identify-words" });
  const problem = errorPlace();
  button = action(h("button", { type: "button", class: "main wide-button", id: "identify", "aria-describedby": "identify-words" }, "Identify a model"), problem, identify);
  watch("state", refresh);
  document.addEventListener("roles", refresh);
  return h(
    "div",
    { class: "card identify" },
    h("h3", {}, "Identify"),
    sentence,
    button,
    problem,
    h(
      "details",
      {},
      h("summary", {}, "Options"),
      field(LABELS.structure, inputs.structure),
      field(LABELS.goal, inputs.goal, { unit: "% of the stroke", hint: "With an error below it the model is ready for use." }),
      field(LABELS.time_limit, inputs.time_limit, { unit: "s", hint: "Then the best model so far is completed." }),
      field(LABELS.sensor_lag, inputs.sensor_lag, { unit: "s", hint: "Time constant of its filter; 0 if it has none." }),
      field(LABELS.norm, inputs.norm),
      field("Name of the model", inputs.name),
    ),
  );
}

const withRole = (role) => readyRecords().filter((one) => roleOf(one.id) === role);

function refresh() {
  const [train, validate] = [withRole("train"), withRole("validate")];
  const names = (records) => records.map((one) => one.name).join(", ");
  button.disabled = train.length === 0;
  if (!train.length) say(sentence, readyRecords().length ? "Mark a record to train with." : "A record has to be ready first.");
  else say(sentence, `Trains with ${names(train)}${validate.length ? `; validates with ${names(validate)}` : ""}.`);
}

async function identify() {
  const options = { structure: inputs.structure.value, norm: inputs.norm.value };
  for (const name of ["goal", "time_limit", "sensor_lag"]) {
    const value = parsed(inputs[name].value);
    const zero = name === "sensor_lag";
    if (value !== null && !(value > 0 || (zero && value === 0))) throw new Error(`${LABELS[name]}: got ${inputs[name].value}, need a number above 0${zero ? ", or 0" : ""}.`);
    if (value !== null) options[name] = value;
  }
  if (inputs.name.value.trim()) options.name = inputs.name.value.trim();
  const ids = (role) => withRole(role).map((one) => one.id);
  const { id } = await post("/api/models", { train: ids("train"), validate: ids("validate"), options });
  announce("The identification has begun.");
  chooseModel(id);
  openStep("model");
  byId("main").focus({ preventScroll: true });
}
