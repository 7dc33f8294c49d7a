// The fourth step: the exports of the model, all files of the folder, and the session as a script.
import { DECLARED } from "./declared.js";
import { byId, h, showCode, table } from "./dom.js";
import { Form } from "./forms.js";
import { bytes } from "./numbers.js";
import { bounds, suggestedRate } from "./path_step.js";
import { button, openJobs, problem, workOn } from "./server.js";
import { fileLink, jobCards, modelChoice } from "./verdict.js";

const form = new Form("export", DECLARED.forms.export);
const period = () => (form.value("rate") ? 1 / form.value("rate") : null);
const RIG = byId("rig-commands").textContent;
let suggested; // the model whose rate is in the form

export function exportView(state, model) {
  const { low, high, slew } = bounds(model ?? { range_v: [0, 100] }, state);
  showCode(byId("rig-commands"), RIG.replace("LIMITS", `--limits ${low} ${high}${slew && ` --slew-rate ${slew}`}`));
  showCode(byId("script"), state.log.join("\n") || "# nothing was done yet");
  const rows = state.files.map(({ path, kind, bytes: n }) => [n === null ? path : fileLink(path, path), kind, bytes(n)]);
  return [
    model && exportsOf(model),
    byId("rig"),
    h("h3", "Files of this folder"),
    h("div#files.files", table("Files of this folder", ["File", "Kind", "Size"], rows)),
    byId("log"),
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
  const look = { class: "button main" };
  return h("div#export-body", { key: "body" },
    modelChoice(),
    form.row(["rate"], "kinds"),
    h("ul.kinds", cards,
      h("li.card",
        h("h3", "Model and report"),
        h("p", "The model is JSON, for Python and the command line. The report is one page that needs no server."),
        h("p.row", fileLink(model.file, "Model (JSON)", look), fileLink(model.report, "Report (HTML)", look)),
      ),
    ),
    h("ul#export-jobs.cards", jobCards(openJobs("export", model.id))),
  );
}
