// The fifth step: the model in other forms, all files of the folder, and the session as a script.
import { post } from "./api.js";
import { action, announce, byId, errorPlace, h, keyed, say, show } from "./dom.js";
import { goTo, modelChoice } from "./models.js";
import { bytes } from "./numbers.js";
import { currentRequest } from "./path.js";
import { chosenModel, jobsOf, session, watch } from "./state.js";
import { openStep } from "./steps.js";
import { fileLink, jobCard } from "./voltages.js";

const KINDS = [
  ["c", "C99", "Sources, numbers and a test for firmware; the same code as Python runs."],
  ["fmu", "FMU", "For co-simulation in Simulink, Modelica and others (FMI 3.0)."],
  ["wasm", "WebAssembly", "For a browser or node, with a JavaScript module."],
  ["wave_table", "Wave table", "One steady cycle of the scan of the Path step, for a generator (CSV)."],
];

export function buildExport() {
  const problem = errorPlace();
  byId("export").append(
    h("h2", { class: "unseen" }, "Export"),
    h("div", { class: "empty", id: "export-empty" }, h("p", {}, "An export needs a model that is ready."), goTo("records", "To the records")),
    h(
      "div",
      { id: "export-body", hidden: true },
      modelChoice(),
      h("ul", { class: "kinds" }, KINDS.map((one) => kindCard(one, problem)), h("li", { class: "card", id: "export-model" })),
      problem,
      h("ul", { id: "export-jobs", class: "cards" }),
    ),
    h("h3", {}, "Files of this folder"),
    h("p", { class: "muted", id: "no-files" }, "There are none yet."),
    h("table", { class: "files", id: "files-table" }, h("caption", { class: "unseen" }, "Files of this folder"), h("thead", {}, h("tr", {}, ["File", "Kind", "Size"].map((one) => h("th", { scope: "col" }, one)))), h("tbody", { id: "files" })),
    script(),
  );
  watch("state", refresh);
}

function kindCard([kind, title, text], problem) {
  const button = action(h("button", { type: "button", class: "main", "aria-label": `Export ${title}` }, "Export"), problem, () => exportAs(kind));
  return h("li", { class: "card" }, h("h3", {}, title), h("p", {}, text), button);
}

async function exportAs(kind) {
  const body = { kind };
  if (kind === "wave_table") {
    const request = currentRequest();
    if (!request.scan) {
      openStep("path", { focus: true });
      throw new Error("A wave table is one cycle of a scan: choose a scan in the Path step first.");
    }
    Object.assign(body, request);
  }
  await post(`/api/models/${chosenModel().id}/export`, body);
  announce("The export has begun.");
}

function refresh(state) {
  const model = chosenModel();
  show(byId("export-empty"), !model);
  show(byId("export-body"), Boolean(model));
  if (model) {
    keyed(byId("export-model"), [model], { create: modelLinks });
    const jobs = jobsOf(model.id, "export").filter((one) => one.status === "running");
    const last = jobsOf(model.id, "export").at(-1);
    keyed(byId("export-jobs"), last?.status === "failed" ? [...jobs, last] : jobs, { create: jobCard });
  }
  const files = [...state.files].sort((a, b) => a.path.localeCompare(b.path));
  show(byId("files-table"), files.length > 0);
  show(byId("no-files"), files.length === 0);
  keyed(byId("files"), files, { key: (one) => one.path, create: fileRow });
  say(byId("script"), state.log.join("\n") || "# nothing was done yet");
}

function modelLinks({ file, report }) {
  return h(
    "div",
    {},
    h("h3", {}, "Model and report"),
    h("p", {}, "The model as JSON, for Python and the command line; the report as one page that needs no server."),
    h(
      "p",
      { class: "row" },
      fileLink(file, "Model (JSON)", { class: "button main" }),
      report && fileLink(report, "Report (HTML)", { class: "button main" }),
      report && fileLink(report, "Look at the report", { class: "button", download: null, target: "_blank", rel: "noopener" }),
    ),
  );
}

function fileRow(file) {
  return h("tr", {}, h("th", { scope: "row", class: "text" }, fileLink(file.path, file.path)), h("td", {}, file.kind ?? ""), h("td", {}, bytes(file.bytes)));
}

function script() {
  const problem = errorPlace();
  const copy = action(h("button", { type: "button" }, "Copy"), problem, async () => {
    await navigator.clipboard.writeText(session.state.log.join("\n"));
    announce("The script is in the clipboard.");
  });
  return h(
    "section",
    { "aria-labelledby": "script-title" },
    h("h3", { id: "script-title" }, "Log as script"),
    h("p", { class: "muted" }, "The commands that do the same in a terminal, in this order."),
    h("pre", { id: "script", tabindex: "0", role: "region", "aria-label": "Commands of this session" }),
    h("p", { class: "row" }, copy),
    problem,
  );
}
