// The second step: the identification as it runs, its verdict, its pictures, and all models side by side.
import { post, remove } from "./api.js";
import { action, announce, byId, errorPlace, h, keyed, say, show, table } from "./dom.js";
import { ComparisonFigure } from "./comparison.js";
import { FitFigure } from "./fit_figure.js";
import { inPage } from "./labels.js";
import { duration, percent, range } from "./numbers.js";
import { chooseModel, chosenModel, jobsOf, recordOf, rememberModel, session, watch } from "./state.js";
import { onStep, openStep } from "./steps.js";
import { verdictBlock } from "./verdict.js";
import { fileLink } from "./voltages.js";

let fit = null;
let comparison = null;
const began = new Map(); // when the server said how long an identification has run
const lately = new Map(); // status of each model as last seen

export function buildModels() {
  fit = new FitFigure();
  comparison = new ComparisonFigure();
  byId("model").append(
    h("h2", { class: "unseen" }, "Model"),
    h("div", { class: "empty", id: "model-empty" }, h("p", {}, "There is no model yet."), goTo("records", "To the records")),
    h("ul", { id: "running", class: "cards", "aria-label": "Identifications" }),
    h("div", { id: "model-body", hidden: true }, modelChoice(), h("div", { id: "verdict" }), h("div", { class: "row next" }, goTo("path", "Make a voltage"), goTo("trust", "How far to trust it"), h("span", { id: "model-report" })), fit.element, h("div", { id: "model-more" }), comparison.element),
  );
  watch("state", refresh);
  onStep("model", () => draw());
  setInterval(tick, 500);
}

export const goTo = (step, text) => h("button", { type: "button", class: "main", onclick: () => openStep(step, { focus: true }) }, text);

// A choice of the model that all steps speak of; shown if there is more than one.
export function modelChoice() {
  const select = h("select", { "aria-label": "Model", class: "model-choice", onchange: () => chooseModel(select.value) });
  const row = h("p", { class: "row model-row" }, h("span", {}, "Model "), select);
  watch("state", (state) => {
    const ready = state.models.filter((one) => one.status === "ready");
    show(row, ready.length > 1);
    keyed(select, ready.map((one) => ({ id: one.id, name: one.name })), { create: (one) => h("option", { value: one.id }, one.name) });
    const chosen = chosenModel();
    if (chosen && select.value !== chosen.id) select.value = chosen.id;
  });
  return row;
}

function refresh(state) {
  const open = state.models.filter((one) => one.status !== "ready");
  for (const one of state.models) noticed(one);
  keyed(byId("running"), open, { create: runningCard, stamp: ({ progress, seconds, provisional, ...rest }) => JSON.stringify(rest) });
  tick();
  const model = chosenModel();
  show(byId("model-empty"), state.models.length === 0);
  show(byId("model-body"), model !== null);
  if (!model) return;
  keyed(byId("verdict"), [{ id: model.id, verdict: model.verdict }], { create: (one) => h("div", {}, verdictBlock(one)) });
  keyed(byId("model-report"), [model], { create: ({ report }) => h("span", {}, report && fileLink(report, "Read the report", { class: "button", download: null, target: "_blank" })) });
  keyed(byId("model-more"), [{ ...model, insight: null }], { create: () => details(model) });
  draw();
}

function draw() {
  const model = chosenModel();
  if (!model) return;
  fit.draw(model);
  comparison.draw(session.state.models.filter((one) => one.status === "ready"), model);
}

// Say the end of an identification to those who do not see it.
function noticed(model) {
  const before = lately.get(model.id);
  lately.set(model.id, model.status);
  if (before === "identifying" && model.status === "ready") {
    announce(`${model.name} is ready: largest error ${percent(model.verdict.largest_percent)} of the stroke.`);
    rememberModel(model.id);
  }
  const heard = began.get(model.id);
  if (heard?.seconds !== model.seconds) began.set(model.id, { seconds: model.seconds, at: performance.now() });
}

function runningCard(model) {
  const problem = errorPlace();
  const end = (text) => action(h("button", { type: "button", class: "quiet", "data-name": `${model.id}-${text}` }, text), problem, () => ended(model, text));
  const title = h("div", { class: "card-head" }, h("h3", {}, model.name), model.status !== "identifying" && removeButton(model, problem));
  if (model.status !== "identifying") {
    const words = model.status === "failed" ? `No model: ${model.error ?? "the identification failed."}` : `Cancelled${model.error ? `: ${model.error}` : "."}`;
    return h("li", { class: "card refused" }, title, h("p", { class: "error", role: "alert" }, words), problem);
  }
  const names = model.train.map((id) => recordOf(id)?.name ?? id).join(", ");
  return h(
    "li",
    { class: "card running" },
    title,
    h("p", { class: "muted" }, `Identifying from ${names}`),
    h("progress", { "aria-label": `Identification of ${model.name}` }),
    h("p", { class: "progress-words", role: "status" }),
    h("p", { class: "elapsed" }),
    h("p", { class: "muted" }, "A first model exists within seconds; the search for a better structure takes minutes with long records. You can go on with other steps meanwhile."),
    h("div", { class: "row" }, end("Finish with the best so far"), end("Cancel")),
    problem,
  );
}

async function ended(model, text) {
  const [job] = jobsOf(model.id, "identify").filter((one) => one.status === "running");
  if (text === "Cancel" && job) await post(`/api/jobs/${job.id}/cancel`);
  else await post(`/api/models/${model.id}/end`);
}

function removeButton(model, problem) {
  const button = h("button", { type: "button", class: "quiet", "aria-label": `Remove ${model.name} from the list` }, "Remove");
  return action(button, problem, () => remove(`/api/models/${model.id}`));
}

// Progress and time change often: only their text is written.
function tick() {
  for (const model of session.state.models) {
    if (model.status !== "identifying") continue;
    const card = byId("running").querySelector(`[data-key="${model.id}"]`);
    if (!card) continue;
    const heard = began.get(model.id);
    const seconds = (heard?.seconds ?? 0) + (performance.now() - (heard?.at ?? performance.now())) / 1000;
    say(card.querySelector(".progress-words"), model.progress || "starting");
    const first = model.provisional ? "; a first model exists" : "";
    say(card.querySelector(".elapsed"), `${duration(Math.round(seconds))} elapsed${first}`);
  }
}

function details(model) {
  const heads = ["Record", "Role", "Largest error", "RMS error", "Samples", "Set aside"];
  const rows = model.table.map((one) => [one.record, one.role, percent(one.largest_percent), percent(one.rms_percent), String(one.samples ?? "\u2013"), String(one.left_out ?? "\u2013")]);
  const problem = errorPlace();
  return h(
    "div",
    { class: "more" },
    h("h3", {}, "Error on each record, in % of the stroke"),
    table("Error on each record", heads, rows),
    h("p", { class: "muted" }, `Known for ${range(model.range_v, "V")}; reaches ${range(model.range_um, "\u00b5m")}. ${model.rig ? `Calibrated on ${model.rig}.` : `Identified in ${duration(model.seconds)}.`}`),
    model.summary?.length > 0 && h("details", {}, h("summary", {}, "Notes of the identification"), h("ul", {}, model.summary.map((one) => h("li", {}, inPage(one))))),
    h("p", { class: "row" }, removeButton(model, problem)),
    problem,
  );
}
