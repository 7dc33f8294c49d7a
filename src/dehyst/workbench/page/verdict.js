// The verdict of a model (its promise as number and colour, then the reasons), and the choice of the model.
import { h, table } from "./dom.js";
import { list, options } from "./forms.js";
import { length, percent, range } from "./numbers.js";
import { reportParts } from "./report.js";
import * as server from "./server.js";

const { button, problem, readyModels, redraw } = server;

const LIGHTS = {
  READY: ["green", "Ready for use"],
  USABLE: ["amber", "Usable, with care"],
  NOT_USABLE: ["red", "Not usable"],
};
export const lightOf = ({ readiness }) => LIGHTS[readiness] ?? ["amber", readiness];

// True if the last check found that the model no longer holds.
export const isOld = ({ check }) => Boolean(check && !check.good);

export function verdictBlock({ verdict }) {
  const [light, words] = lightOf(verdict);
  const { largest_percent: largest, largest_um: um, rms_percent: rms, basis, goal, why = [], apart } = verdict;
  return h("div", { class: `outcome ${light}`, role: "status", "aria-label": "Verdict" },
    h("strong", words),
    h("b", `${percent(largest)} of the stroke `, h("small", `or ${length(um)}`)),
    h("p", `is the largest error to expect (RMS ${percent(rms)}, from ${basis}; goal ${percent(goal)}), ${apart}.`),
    list([...why, ...verdict.remarks], "remarks"),
  );
}

// The verdict of each of several axes, and their coupling.
export function axesBlock({ axes, coupling }) {
  if (!coupling) return null;
  const { matrix, verdicts } = coupling;
  const rows = axes.map(({ name, range_v: volts, range_um: reach }) => {
    const { largest_percent: largest, largest_um: um, rms_percent: rms } = verdicts[name];
    const [colour, words] = lightOf(verdicts[name]);
    const light = h("td.text", h("span", { class: `light ${colour}` }, words));
    return [name, light, percent(largest), length(um), percent(rms), range(volts, "V"), range(reach, "\u00b5m")];
  });
  const heads = ["Axis", { text: "Verdict", class: "text" }, "Largest error", "Largest error", "RMS error", "Known for", "Reaches"];
  const moved = (i, j) => `${axes[j].name} moves ${axes[i].name} by ${percent(100 * matrix[i][j])}`;
  const pairs = axes.flatMap((_, i) => axes.flatMap((_, j) => (i === j ? [] : [moved(i, j)])));
  return h("section", { "aria-label": "Axes", key: "axes" },
    table("Verdict of each axis", heads, rows),
    h("p.muted", `Coupling: ${pairs.join(", ")}. It is compensated.`),
  );
}

// A choice of the model for all steps, if there are several models.
export function modelChoice() {
  const models = readyModels();
  if (models.length < 2) return null;
  const onchange = (event) => server.chooseModel(event.target.value);
  const about = { "aria-label": "Model", class: "model-choice", value: server.chosenModel().id, onchange };
  const select = h("select", about, options(models.map((model) => [model.id, model.name])));
  return h("p.row.model-row", h("span", "Model "), select);
}

// The sections of a report in the folder, once they are loaded. An error is shown at the place `path`.
const reports = new Map();
export function mounted(path) {
  if (!reports.has(path)) {
    reports.set(path, null);
    const arrived = (text) => reports.set(path, reportParts(text)) && redraw();
    server.textOfFile(path).then(arrived).catch((error) => server.complain(path, error.message));
  }
  return reports.get(path);
}

export const fileLink = (path, text, attributes = {}) =>
  h("a", { href: server.fileAddress(path), download: path.split("/").at(-1), ...attributes }, text);

// Cards of running and failed jobs, with a button to cancel.
export const jobCards = (jobs) =>
  jobs.map(({ id, status, error, progress }) => {
    const alert = h("p.error", { role: "alert" }, error ?? "It failed.");
    if (status === "failed") return h("li.card.refused", { key: id }, alert);
    return h("li.card", { key: id },
      h("p", { role: "status" }, progress || "Computing\u2026"),
      h("progress", { "aria-label": "Job" }),
      button("Cancel", `job ${id}`, () => server.cancelJob(id), { class: "quiet" }),
      problem(`job ${id}`),
    );
  });
