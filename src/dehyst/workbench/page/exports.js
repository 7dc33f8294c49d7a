// The fourth step: the exports of the model, all files of the folder, and the session as a script.
import { DECLARED } from "./declared.js";
import { byId, h, table } from "./dom.js";
import { Form } from "./forms.js";
import { bytes } from "./numbers.js";
import { suggestedRate } from "./path_step.js";
import { button, openJobs, problem, workOn } from "./server.js";
import { fileLink, jobCards, modelChoice } from "./verdict.js";

const form = new Form("export", DECLARED.forms.export);
const period = () => (form.value("rate") ? 1 / form.value("rate") : null);
let suggested; // the model whose rate is in the form

export function exportView({ files, log }, model) {
  const sorted = [...files].sort((a, b) => a.path.localeCompare(b.path));
  const rows = sorted.map(({ path, kind, bytes: n }) => [n === null ? path : fileLink(path, path), kind, bytes(n)]);
  return [
    model && exportsOf(model),
    byId("rig"),
    h("h3", "Files of this folder"),
    h("div#files.files", table("Files of this folder", ["File", "Kind", "Size"], rows)),
    script(log),
  ];
}

function exportsOf(model) {
  if (suggested !== model.id) form.values.rate = model.timed ? suggestedRate(model) : "";
  suggested = model.id;
  // Coupled axes can be exported as C only.
  const kinds = Object.entries(DECLARED.exports).filter(([kind]) => kind === "c" || !model.coupling);
  const cards = kinds.map(([kind, [title, text]]) => {
    const about = { class: "main", "aria-label": `Export ${title}` };
    const work = () => workOn(model.id, "export", { kind, period: period() }, "The export has begun.");
    const act = button("Export", `export ${kind}`, work, about);
    return h("li.card", h("h3", title), h("p", text), problem(`export ${kind}`), act);
  });
  return h("div#export-body", { key: "body" },
    modelChoice(),
    form.row(["rate"], "kinds"),
    h("ul.kinds", cards, h("li.card", modelLinks(model))),
    h("ul#export-jobs.cards", jobCards(openJobs("export", model.id))),
  );
}

function modelLinks({ file, report }) {
  const look = { class: "button main" };
  return [
    h("h3", "Model and report"),
    h("p", "The model is JSON, for Python and the command line. The report is one page that needs no server."),
    h("p.row", fileLink(file, "Model (JSON)", look), report && fileLink(report, "Report (HTML)", look)),
  ];
}

function script(log) {
  const about = { id: "script", tabindex: "0", role: "region", "aria-label": "Commands of this session" };
  return h("section", { "aria-labelledby": "script-title" },
    h("h3#script-title", "Log as script"),
    h("p.muted", "These commands do the same in a terminal, in this order."),
    h("pre", about, log.join("\n") || "# nothing was done yet"),
  );
}
