// The second step: the identification as it runs, its verdict, its pictures, and all models side by side.
import { h, table } from "./dom.js";
import { duration, percent, range } from "./numbers.js";
import * as server from "./server.js";
import { goTo, isOpen, needsModel } from "./steps.js";
import { assessment, checkCard } from "./trust.js";
import { VERDICT_HEADS, axesBlock, fileLink, modelChoice, mounted, verdictBlock, verdictCells } from "./verdict.js";

const { announce, button, problem, readyModels, redraw, session } = server;
const began = new Map(); // when the server said how long an identification has run
let known = null; // models that were ready when the page last looked

// The time that has passed is written between two states of the server, too.
setInterval(() => {
  if (isOpen("model") && session.state.models.some((one) => one.status === "identifying")) redraw();
}, 500);

// A model that has become ready is announced, and all steps speak of it.
server.watch(({ revision, models }) => {
  if (revision === undefined) return;
  for (const { id, seconds } of models) {
    if (began.get(id)?.seconds !== seconds) began.set(id, { seconds, at: performance.now() });
  }
  const ready = readyModels();
  const fresh = known && ready.find(({ id }) => !known.has(id));
  known = new Set(ready.map(({ id }) => id));
  if (!fresh) return;
  announce(`${fresh.name} is ready: largest error ${percent(fresh.verdict.largest_percent)} of the stroke.`);
  server.chooseModel(fresh.id);
});

export function modelView({ models }, model) {
  return [
    models.length === 0 && needsModel("There is no model yet."),
    h("ul#running.cards", { "aria-label": "Identifications" },
      models.filter((one) => one.status !== "ready").map(runningCard),
    ),
    h("div#model-body", { hidden: !model }, model && body(model)),
  ];
}

function body(model) {
  const look = { class: "button", download: null, target: "_blank" };
  const origin = model.origin || `Identified in ${duration(model.seconds)}.`;
  const ranges = `Known for ${range(model.range_v, "V")}; reaches ${range(model.range_um, "\u00b5m")}.`;
  return [
    modelChoice(),
    h("div#verdict", verdictBlock(model), axesBlock(model)),
    h("div.row.next",
      goTo("path", "Make a voltage"),
      fileLink(model.report, "Read the report", look),
    ),
    h("p.muted", `${ranges} ${origin} `, server.removeButton("models", model)),
    problem(`models ${model.id}`),
    comparison(readyModels(), model),
    checkCard(model),
    assessment(model),
    problem(model.report),
    h("div#model-report", mounted(model.report)?.element),
  ];
}

function runningCard(model) {
  const { id, name, status, error, progress, provisional, train } = model;
  const running = status === "identifying";
  const title = h("div.card-head", h("h3", name), !running && server.removeButton("models", model));
  const place = `models ${id}`;
  if (!running) {
    const failed = `No model: ${error ?? "the identification failed."}`;
    const words = status === "failed" ? failed : `Cancelled${error ? `: ${error}` : "."}`;
    const alert = h("p.error", { role: "alert" }, words);
    return h("li.card.refused", { key: id }, title, alert, problem(place));
  }
  const { seconds, at } = began.get(id);
  const elapsed = duration(Math.round(seconds + (performance.now() - at) / 1000));
  const end = () => server.workOn(id, "end");
  const [job] = server.openJobs("identify", id);
  const cancel = () => (job ? server.cancelJob(job.id) : end());
  return h("li.card.running", { key: id },
    title,
    h("p.muted", `Identifying from ${train.map((one) => server.recordOf(one)?.name ?? one).join(", ")}`),
    h("progress", { "aria-label": `Identification of ${name}` }),
    h("p.progress-words", { role: "status" }, progress || "starting"),
    h("p.elapsed", `${elapsed} elapsed${provisional ? "; a first model exists" : ""}`),
    h("p.muted",
      "A first model exists within seconds; the search for a better structure takes minutes with long records. You " +
        "can go on with other steps meanwhile.",
    ),
    h("div.row",
      button("Finish with the best so far", place, end, { class: "quiet" }),
      button("Cancel", place, cancel, { class: "quiet" }),
    ),
    problem(place),
  );
}

// Models of the record on which the chosen one is judged, held out if there is one; nothing if there is none but it.
function comparison(all, chosen) {
  const uses = (model) => [...model.train, ...model.validate];
  const record = chosen.validate[0] ?? chosen.train[0];
  const models = all.filter((one) => uses(one).includes(record));
  if (models.length < 2) return null;
  // A smaller error is a better one only on the same records.
  const records = models.map((one) => `${[...one.train].sort()} ${[...one.validate].sort()}`);
  const same = new Set(records).size === 1;
  const cell = (verdict) => (name) => {
    const best = same && models.every((one) => verdict[name] <= one.verdict[name]);
    const mark = best && h("span.unseen", " (best)");
    return h("td", { class: best && "best" }, percent(verdict[name]), mark);
  };
  const heads = ["Model", ...VERDICT_HEADS, "Structure", "Time taken", "From"];
  const rows = models.map((one) => [
    one.name,
    ...verdictCells(one.verdict, cell(one.verdict)),
    one.options?.structure ?? "auto",
    duration(one.seconds),
    one.verdict.basis ?? "",
  ]);
  return h("section.comparison", { "aria-labelledby": "comparison", key: "comparison" },
    h("h2#comparison", "Models side by side"),
    table("Error, verdict and time of each model", heads, rows),
  );
}
