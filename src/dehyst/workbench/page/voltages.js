// The voltages that were written, with their downloads, and the jobs that write one.
import { post } from "./api.js";
import { action, byId, errorPlace, h, keyed, show } from "./dom.js";
import { inPage } from "./labels.js";
import { duration, range, whole } from "./numbers.js";
import { modelOf, watch } from "./state.js";

export const fileLink = (path, text, attributes = {}) =>
  h("a", { href: `/files/${path.split("/").map(encodeURIComponent).join("/")}`, download: path.split("/").at(-1), ...attributes }, text);

export function voltageList() {
  watch("state", refresh);
  return h("section", { "aria-labelledby": "voltages-title", id: "voltages", hidden: true }, h("h3", { id: "voltages-title" }, "Voltages written"), h("ul", { id: "voltage-jobs", class: "cards" }), h("ul", { id: "voltage-list", class: "cards" }));
}

function refresh(state) {
  const last = state.jobs.filter((one) => one.kind === "compensate").at(-1);
  const jobs = last && ["running", "failed"].includes(last.status) ? [last] : [];
  show(byId("voltages"), state.voltages.length + jobs.length > 0);
  keyed(byId("voltage-jobs"), jobs, { create: jobCard });
  keyed(byId("voltage-list"), [...state.voltages].reverse(), { create: card });
}

// A running or failed job, with the way to end it.
export function jobCard(job) {
  if (job.status === "failed") return h("li", { class: "card refused" }, h("p", { class: "error", role: "alert" }, inPage(job.error ?? "It failed.")));
  const problem = errorPlace();
  const cancel = action(h("button", { type: "button", class: "quiet" }, "Cancel"), problem, () => post(`/api/jobs/${job.id}/cancel`));
  return h("li", { class: "card" }, h("p", { role: "status" }, job.progress || "Computing\u2026"), h("progress", { "aria-label": "Job" }), cancel, problem);
}

// The first remark, and the others on request.
function remarks([first, ...others]) {
  if (!first) return null;
  const list = (items) => h("ul", { class: "remarks" }, items.map((one) => h("li", {}, inPage(one))));
  return [list([first]), others.length > 0 && h("details", {}, h("summary", {}, others.length === 1 ? "One more thing to know" : `${others.length} more things to know`), list(others))];
}

function card(voltage) {
  const clamped = voltage.clamped > 0;
  return h(
    "li",
    { class: `card ${clamped ? "refused" : ""}` },
    h("div", { class: "card-head" }, h("h3", {}, voltage.name), fileLink(voltage.file, "Download CSV", { class: "button main" })),
    h("p", {}, `${range(voltage.range_v, "V")}, ${whole(voltage.samples)} samples in ${duration(voltage.seconds)}, by ${modelOf(voltage.model)?.name ?? "a model that was removed"}.`),
    clamped && h("p", { class: "error" }, `${whole(voltage.clamped)} voltages are clamped: the path is missed there.`),
    remarks(voltage.words),
  );
}
