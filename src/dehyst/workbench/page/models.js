// The second step: the identification as it runs, its verdict, its pictures, and all models side by side.
import { cancelJob, endIdentification, remove } from "./api.js";
import { h, table } from "./dom.js";
import { announce, button, fold, list, problem } from "./forms.js";
import { FitFigure, comparison } from "./fit_figure.js";
import { inPage } from "./labels.js";
import { duration, percent, range } from "./numbers.js";
import { chooseModel, chosenModel, openJobs, readyModels, recordOf, redraw, session } from "./state.js";
import { isOpen } from "./steps.js";
import { fileLink, goTo, modelChoice, needsModel, verdictBlock } from "./verdict.js";

const fit = new FitFigure();
const began = new Map(); // when the server said how long an identification has run
const lately = new Map(); // status of each model as last seen

const MEANWHILE =
  "A first model exists within seconds; the search for a better structure takes minutes with long records. You can " +
  "go on with other steps meanwhile.";

// The time that has passed is written between two states of the server, too.
setInterval(() => {
  if (isOpen("model") && session.state.models.some((one) => one.status === "identifying")) redraw();
}, 500);

export function modelView({ models }) {
  models.forEach(noticed);
  const model = chosenModel();
  return [
    h("h2", { class: "unseen" }, "Model"),
    models.length === 0 && needsModel("There is no model yet."),
    h(
      "ul",
      { id: "running", class: "cards", "aria-label": "Identifications" },
      models.filter((one) => one.status !== "ready").map(runningCard),
    ),
    h("div", { id: "model-body", hidden: !model }, model && body(model)),
  ];
}

function body(model) {
  const report = { class: "button", download: null, target: "_blank" };
  return [
    modelChoice(),
    h("div", { id: "verdict" }, verdictBlock(model)),
    h(
      "div",
      { class: "row next" },
      goTo("path", "Make a voltage"),
      goTo("trust", "How far to trust it"),
      model.report && fileLink(model.report, "Read the report", report),
    ),
    fit.show(model),
    details(model),
    comparison(readyModels(), model),
  ];
}

// Say the end of an identification to those who do not see it.
function noticed({ id, name, status, verdict, seconds }) {
  if (lately.get(id) === "identifying" && status === "ready") {
    announce(`${name} is ready: largest error ${percent(verdict.largest_percent)} of the stroke.`);
    chooseModel(id);
  }
  lately.set(id, status);
  if (began.get(id)?.seconds !== seconds) began.set(id, { seconds, at: performance.now() });
}

const removeButton = ({ id, name }) =>
  button("Remove", `model ${id}`, () => remove("models", id), {
    class: "quiet",
    "aria-label": `Remove ${name} from the list`,
  });

function runningCard(model) {
  const { id, name, status, error, progress, provisional, train } = model;
  const running = status === "identifying";
  const title = h("div", { class: "card-head" }, h("h3", {}, name), !running && removeButton(model));
  const place = `model ${id}`;
  if (!running) {
    const failed = `No model: ${error ?? "the identification failed."}`;
    const words = status === "failed" ? failed : `Cancelled${error ? `: ${error}` : "."}`;
    const alert = h("p", { class: "error", role: "alert" }, words);
    return h("li", { class: "card refused", key: id }, title, alert, problem(place));
  }
  const { seconds, at } = began.get(id);
  const elapsed = duration(Math.round(seconds + (performance.now() - at) / 1000));
  const cancel = () => {
    const [job] = openJobs("identify", id);
    return job ? cancelJob(job.id) : endIdentification(id);
  };
  return h(
    "li",
    { class: "card running", key: id },
    title,
    h("p", { class: "muted" }, `Identifying from ${train.map((one) => recordOf(one)?.name ?? one).join(", ")}`),
    h("progress", { "aria-label": `Identification of ${name}` }),
    h("p", { class: "progress-words", role: "status" }, progress || "starting"),
    h("p", { class: "elapsed" }, `${elapsed} elapsed${provisional ? "; a first model exists" : ""}`),
    h("p", { class: "muted" }, MEANWHILE),
    h(
      "div",
      { class: "row" },
      button("Finish with the best so far", place, () => endIdentification(id), { class: "quiet" }),
      button("Cancel", place, cancel, { class: "quiet" }),
    ),
    problem(place),
  );
}

function details(model) {
  const heads = ["Record", "Role", "Largest error", "RMS error", "Samples", "Set aside"];
  const rows = model.table.map((one) => [
    one.record,
    one.role,
    percent(one.largest_percent),
    percent(one.rms_percent),
    String(one.samples ?? "\u2013"),
    String(one.left_out ?? "\u2013"),
  ]);
  const origin = model.rig ? `Calibrated on ${model.rig}.` : `Identified in ${duration(model.seconds)}.`;
  const ranges = `Known for ${range(model.range_v, "V")}; reaches ${range(model.range_um, "\u00b5m")}.`;
  return h(
    "div",
    { class: "more" },
    h("h3", {}, "Error on each record, in % of the stroke"),
    table("Error on each record", heads, rows),
    h("p", { class: "muted" }, `${ranges} ${origin}`),
    model.summary?.length > 0 && fold("Notes of the identification", list(model.summary.map(inPage))),
    h("p", { class: "row" }, removeButton(model)),
    problem(`model ${model.id}`),
  );
}
