// The steps from a record to an export, as tabs with the state of each step. One step is open.
import { byId, fill, h } from "./dom.js";
import { percent } from "./numbers.js";
import { chosenModel, readyRecords, session, watch } from "./server.js";
import { isOld } from "./verdict.js";

const counted = ({ length }, noun) => `${length} ${noun}${length === 1 ? "" : "s"}`;
// The state of a step: done, with `words`, or not begun, with the text `before`.
const reached = (words, before) => (words ? { text: words, mark: "done" } : { text: before });
const pathState = ({ voltages }) => reached(voltages.length > 0 && counted(voltages, "voltage"), "no voltage yet");
// Title and state of each step, and whether it needs a model. A mark colours the number.
const STEPS = {
  records: ["Records", recordsState],
  model: ["Model", modelState],
  path: ["Path and voltage", pathState, true],
  export: ["Export", ({ files }) => ({ text: counted(files, "file") }), true],
};
const IDS = Object.keys(STEPS);
let pages = {};
let open = null;

// `views` has a function for each step, which returns its content from the state and the chosen model. Only the open
// step is drawn.
export function buildSteps(views) {
  pages = views;
  byId("steps").onkeydown = byKeys;
  window.addEventListener("hashchange", () => openStep(location.hash.slice(1)));
  watch(refresh);
  openStep(location.hash.slice(1));
}

export function openStep(wanted, { focus = false } = {}) {
  const before = open;
  open = IDS.includes(wanted) ? wanted : "records";
  // "Back" in the browser opens the last step. The first entry of the history is replaced: it is no step.
  const known = IDS.includes(location.hash.slice(1));
  if (location.hash !== `#${open}`) history[known ? "pushState" : "replaceState"](null, "", `#${open}`);
  refresh(session.state);
  if (before !== open) window.scrollTo({ top: 0, behavior: "instant" });
  byId(`step-${open}`).scrollIntoView({ block: "nearest", inline: "nearest", behavior: "instant" });
  if (focus) byId(`step-${open}`).focus();
}

function refresh(state) {
  fill(byId("steps"), IDS.map((id, k) => tab(id, k, state)));
  for (const id of IDS) byId(id).hidden = id !== open;
  const [title, , needs] = STEPS[open];
  const model = chosenModel();
  fill(byId(open), h("h2.unseen", title), needs && !model && needsModel(), pages[open](state, model));
}

export const goTo = (step, text, look = "main") =>
  h("button", { type: "button", class: look, onclick: () => openStep(step, { focus: true }) }, text);

export const needsModel = () => h("div.empty", h("p", "There is no model yet."), goTo("records", "To the records"));

function tab(id, k, state) {
  const [title, describe, needs] = STEPS[id];
  const { text, mark } = needs && !chosenModel() ? { text: "needs a model" } : describe(state);
  const chosen = id === open;
  const about = { role: "tab", type: "button", id: `step-${id}`, "aria-controls": id, "aria-selected": String(chosen) };
  return h("button",
    { ...about, tabindex: chosen ? "0" : "-1", "data-mark": mark || undefined, onclick: () => openStep(id) },
    h("span.number", { "aria-hidden": "true" }, String(k + 1)),
    h("span.title", title),
    h("small", text),
  );
}

function byKeys(event) {
  const at = IDS.findIndex((id) => byId(`step-${id}`) === document.activeElement);
  const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: IDS.length - 1 }[event.key];
  if (to === undefined || at < 0) return;
  event.preventDefault();
  openStep(IDS[(to + IDS.length) % IDS.length], { focus: true });
}

function recordsState({ records }) {
  if (records.some((record) => record.status === "reading")) return { text: "reading\u2026", mark: "busy" };
  const refused = records.filter((record) => record.status === "refused").length;
  if (refused) return { text: refused === 1 ? "1 needs help" : `${refused} need help`, mark: "bad" };
  return reached(readyRecords().length > 0 && `${readyRecords().length} ready`, "none yet");
}

function modelState({ models }) {
  if (models.some((model) => model.status === "identifying")) return { text: "identifying\u2026", mark: "busy" };
  const model = chosenModel();
  if (model && isOld(model)) return { text: "no longer true", mark: "bad" };
  return reached(model && `${percent(model.verdict.largest_percent)} largest error`, "none yet");
}
