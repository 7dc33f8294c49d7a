// The second step: running identifications, then the verdict of the model, its pictures and its assessment.
import { h } from "./dom.js";
import { fold } from "./forms.js";
import { duration, range } from "./numbers.js";
import * as server from "./server.js";
import { goTo, needsModel } from "./steps.js";
import { assessment, checkCard } from "./trust.js";
import { axesBlock, fileLink, isOld, modelChoice, mounted, verdictBlock } from "./verdict.js";

const { button, problem } = server;

export function modelView({ models }, model) {
  return [
    models.length === 0 && needsModel(),
    h("ul#running.cards", { "aria-label": "Identifications" },
      models.filter((other) => other.status !== "ready").map(runningCard),
    ),
    h("div#model-body", { hidden: !model }, model && body(model)),
  ];
}

function body(model) {
  // Only the present verdict is open: of the check, or of the identification.
  const old = isOld(model);
  const look = { class: "button", download: null, target: "_blank" };
  const origin = model.origin || `Identified in ${duration(model.seconds)}.`;
  const ranges = `Known for ${range(model.range_v, "V")}; reaches ${range(model.range_um, "\u00b5m")}.`;
  return [
    modelChoice(),
    old ? checkCard(model) : h("div#verdict", verdictBlock(model), axesBlock(model)),
    h("div.row.next",
      goTo("path", "Make a voltage", old ? "" : "main"),
      fileLink(model.report, "Read the report", look),
    ),
    h("p.muted", `${ranges} ${origin} `, server.removeButton("models", model)),
    problem(`models ${model.id}`),
    old ? fold("The promise before that record", verdictBlock(model), axesBlock(model)) : checkCard(model),
    assessment(model),
    h("h2", "The identification"),
    problem(model.report),
    h("div#model-report", mounted(model.report)),
  ];
}

function runningCard(model) {
  const { id, name, status, error, progress, seconds, train } = model;
  const running = status === "identifying";
  const title = h("div.card-head", h("h3", name), !running && server.removeButton("models", model));
  const place = `models ${id}`;
  if (!running) {
    const failed = `No model: ${error ?? "the identification failed."}`;
    const words = status === "failed" ? failed : `Cancelled${error ? `: ${error}` : "."}`;
    const alert = h("p.error", { role: "alert" }, words);
    return h("li.card.refused", { key: id }, title, alert, problem(place));
  }
  const quiet = { class: "quiet" };
  const end = () => server.workOn(id, "end");
  const [job] = server.openJobs("identify", id);
  const cancel = () => (job ? server.cancelJob(job.id) : end());
  return h("li.card.running", { key: id },
    title,
    h("p.muted", `Identifying from ${train.map((key) => server.recordOf(key)?.name ?? key).join(", ")}`),
    h("progress", { "aria-label": `Identification of ${name}` }),
    h("p", { role: "status" }, progress || "starting"),
    h("p.elapsed", `${duration(Math.round(seconds))} elapsed`),
    h("div.row", button("Finish with the best so far", place, end, quiet), button("Cancel", place, cancel, quiet)),
    problem(place),
  );
}
