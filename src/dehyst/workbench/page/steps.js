// The steps from a record to a rig, as tabs that show how far each is.
import { byId, h, say } from "./dom.js";
import { percent } from "./numbers.js";
import { chosenModel, readyRecords, watch } from "./state.js";

const STEPS = [
  ["records", "Records", recordsState],
  ["model", "Model", modelState],
  ["trust", "Trust", trustState],
  ["path", "Path and voltage", pathState],
  ["export", "Export", exportState],
  ["rig", "Rig", rigState],
];
const shown = [];

export function buildSteps() {
  const list = byId("steps");
  STEPS.forEach(([id, title], k) => {
    const tab = h(
      "button",
      { role: "tab", type: "button", id: `step-${id}`, "aria-controls": id, onclick: () => openStep(id) },
      h("span", { class: "number", "aria-hidden": "true" }, String(k + 1)),
      h("span", { class: "title" }, title),
      h("small", {}, ""),
    );
    list.append(tab);
  });
  list.addEventListener("keydown", byKeys);
  window.addEventListener("hashchange", () => openStep(location.hash.slice(1)));
  watch("state", refresh);
  openStep(location.hash.slice(1));
}

// Call `watcher` when a step becomes visible: what is hidden is not drawn.
export function onStep(id, watcher) {
  shown.push([id, watcher]);
}

export const isOpen = (id) => !byId(id).hidden;

export function openStep(wanted, { focus = false } = {}) {
  const current = STEPS.some(([id]) => id === wanted) ? wanted : "records";
  const wasOpen = isOpen(current);
  for (const [id] of STEPS) {
    const tab = byId(`step-${id}`);
    const open = id === current;
    tab.setAttribute("aria-selected", String(open));
    tab.tabIndex = open ? 0 : -1;
    byId(id).hidden = !open;
  }
  const before = location.hash.slice(1);
  // Back leads to the step before; the page's own first entry is no step.
  if (before !== current) history[STEPS.some(([id]) => id === before) ? "pushState" : "replaceState"](null, "", `#${current}`);
  if (!wasOpen) window.scrollTo({ top: 0, behavior: "instant" });
  byId(`step-${current}`).scrollIntoView({ block: "nearest", inline: "nearest", behavior: "instant" });
  for (const [id, watcher] of shown) if (id === current) watcher();
  if (focus) byId(`step-${current}`).focus();
}

function byKeys(event) {
  const at = STEPS.findIndex(([id]) => byId(`step-${id}`) === document.activeElement);
  const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: STEPS.length - 1 }[event.key];
  if (to === undefined || at < 0) return;
  event.preventDefault();
  openStep(STEPS[(to + STEPS.length) % STEPS.length][0], { focus: true });
}

function refresh(state) {
  for (const [id, , describe] of STEPS) {
    const { text, mark = "" } = describe(state);
    const tab = byId(`step-${id}`);
    say(tab.querySelector("small"), text);
    tab.dataset.mark = mark;
  }
}

function recordsState(state) {
  if (state.records.some((one) => one.status === "reading")) return { text: "reading\u2026", mark: "busy" };
  const count = readyRecords().length;
  const refused = state.records.filter((one) => one.status === "refused").length;
  if (refused) return { text: refused === 1 ? "1 needs help" : `${refused} need help`, mark: "bad" };
  return count ? { text: count === 1 ? "1 ready" : `${count} ready`, mark: "done" } : { text: "none yet" };
}

function modelState(state) {
  if (state.models.some((one) => one.status === "identifying")) return { text: "identifying\u2026", mark: "busy" };
  const model = chosenModel();
  if (!model) return { text: "none yet" };
  return { text: `${percent(model.verdict.largest_percent)} largest error`, mark: "done" };
}

function trustState() {
  const model = chosenModel();
  if (!model) return { text: "needs a model" };
  return model.insight ? { text: "assessed", mark: "done" } : { text: "not assessed yet" };
}

function pathState(state) {
  if (!chosenModel()) return { text: "needs a model" };
  const count = state.voltages.length;
  if (!count) return { text: "no voltage yet" };
  return { text: count === 1 ? "1 voltage" : `${count} voltages`, mark: "done" };
}

function exportState(state) {
  if (!chosenModel()) return { text: "needs a model" };
  return { text: `${state.files.length} files` };
}

function rigState(state) {
  const { status } = state.rig;
  if (status === "none") return { text: "not connected" };
  return { text: status, mark: { lost: "bad", connected: "done" }[status] ?? "busy" };
}
