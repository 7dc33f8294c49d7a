// The fourth step: a wanted path, the voltage for it as it is drawn, and the file that the server writes.
import { getColumns, post } from "./api.js";
import { action, announce, byId, errorPlace, field, h, number, say, show } from "./dom.js";
import { modelChoice, goTo } from "./models.js";
import { duration, length, parsed, percent, plain, range, roundDown, short, whole } from "./numbers.js";
import { PathFigures } from "./path_figures.js";
import { parsedPath, sampled } from "./path_points.js";
import { compensatorOf, plan } from "./planner.js";
import { ScanForm } from "./scans.js";
import { chosenModel, watch } from "./state.js";
import { onStep, isOpen } from "./steps.js";
import { bandOf, lightOf, remarksOf } from "./verdict.js";
import { voltageList } from "./voltages.js";

const SOURCES = [
  ["scan", "A scan"],
  ["points", "Draw points"],
  ["file", "A file"],
];
const view = { source: "scan", points: null, file: null, asked: 0 };
let form = null;
let scans = null;
let figures = null;
let words = null;
let problem = null;

export function buildPath() {
  scans = new ScanForm(replan);
  form = { low: number(), high: number(), slew: number({ placeholder: "none" }), rate: number({ value: "1000" }) };
  for (const input of Object.values(form)) input.addEventListener("input", replan);
  figures = new PathFigures((points) => {
    view.points = points;
    replan();
  });
  words = h("div", { id: "plan-words", class: "plan", role: "status" });
  problem = errorPlace();
  const write = action(h("button", { type: "button", class: "main wide-button", id: "write" }, "Write voltage"), problem, writeVoltage);
  byId("path").append(
    h("h2", { class: "unseen" }, "Path and voltage"),
    h("div", { class: "empty", id: "path-empty" }, h("p", {}, "A path needs a model that is ready."), goTo("records", "To the records")),
    h(
      "div",
      { class: "split", id: "path-body", hidden: true },
      h("div", { class: "side" }, modelChoice(), h("div", { class: "card" }, sourceChoice(), sources(), outputForm(), write, problem), voltageList()),
      h("div", { class: "stage" }, words, figures.element),
    ),
  );
  watch("state", refresh);
  onStep("path", replan);
}

function sourceChoice() {
  const one = ([name, label]) => {
    const input = h("input", { type: "radio", name: "source", value: name, checked: name === view.source });
    input.addEventListener("change", () => chooseSource(name));
    return h("label", { class: "tick" }, input, label);
  };
  return h("fieldset", { class: "row" }, h("legend", {}, "The wanted path"), SOURCES.map(one));
}

function chooseSource(name) {
  view.source = name;
  for (const [other] of SOURCES) show(byId(`source-${other}`), other === name);
  if (name === "points") view.points ??= firstPoints();
  replan();
}

function sources() {
  const input = h("input", { type: "file", accept: ".csv,.txt,.dat,.tsv", id: "path-file" });
  input.addEventListener("change", () => readPathFile(input.files[0]));
  return [
    h("div", { id: "source-scan" }, scans.element),
    h("div", { id: "source-points", hidden: true }, figures.table),
    h("div", { id: "source-file", hidden: true }, field("Table of time and displacement", input, { hint: "columns such as time_s,displacement_um" })),
  ];
}

function outputForm() {
  return h(
    "div",
    { class: "fields" },
    field("Lowest voltage", form.low, { unit: "V" }),
    field("Highest voltage", form.high, { unit: "V" }),
    field("Largest slew rate", form.slew, { unit: "V/s" }),
    field("Samples a second", form.rate, { unit: "Hz" }),
  );
}

// Reachable ranges a second that a suggested path goes at most: half of the speed of the model's records, as hysteresis
// makes a voltage steeper than its path.
function pace({ range_v: [low, high], slew_v_per_s: slew }) {
  return slew ? (0.5 * slew) / (high - low) : Infinity;
}

function firstPoints() {
  const [low, high] = chosenModel().range_um;
  // The first quarter goes through 0.55 of the range.
  const seconds = 1 / roundDown(Math.min(1, pace(chosenModel()) / 2.2));
  return [0, 0.25, 0.5, 0.75, 1].map((t, k) => [t * seconds, low + [0.2, 0.75, 0.35, 0.6, 0.2][k] * (high - low)]);
}

async function readPathFile(file) {
  if (!file) return;
  try {
    view.file = parsedPath(await file.text());
    const steps = view.file.slice(1).map((one, k) => one[0] - view.file[k][0]);
    form.rate.value = short(1 / Math.min(...steps.slice(0, 1000)), 6);
    replan();
  } catch (error) {
    view.file = null;
    cannotPlan(`${file.name}: ${error.message}`);
  }
}

function refresh() {
  const model = chosenModel();
  show(byId("path-empty"), !model);
  show(byId("path-body"), Boolean(model));
  if (!model || view.model === model.id) return;
  view.model = model.id;
  view.points = view.source === "points" ? firstPoints() : null;
  [form.low.value, form.high.value] = model.range_v.map((one) => plain(one, 6));
  form.slew.value = model.slew_v_per_s ? plain(model.slew_v_per_s, 6) : "";
  scans.suggest(model.range_um, pace(model));
  replan();
}

// Plan again at the next frame: many changes at once are one.
function replan() {
  if (!isOpen("path") || !chosenModel()) return;
  view.frame ??= requestAnimationFrame(() => {
    view.frame = undefined;
    planNow();
  });
}

function numberOf(name, label, { least = -Infinity, optional = false } = {}) {
  const value = parsed(form[name].value);
  if (value === null && optional) return null;
  if (value === null || !(value > least)) throw new Error(`${label}: got ${form[name].value || "nothing"}, need a number${least === 0 ? " above 0" : ""}.`);
  return value;
}

function options() {
  const limits = [numberOf("low", "Lowest voltage"), numberOf("high", "Highest voltage")];
  if (!(limits[0] < limits[1])) throw new Error("The lowest voltage is not below the highest one.");
  return { limits, slew: numberOf("slew", "Slew rate", { least: 0, optional: true }), rate: numberOf("rate", "Samples a second", { least: 0 }) };
}

const request = { scan: () => ({ scan: scans.scan() }), points: () => ({ points: view.points }), file: () => ({ points: view.file }) };

async function wantedPath(rate) {
  if (view.source === "scan") {
    const [time, wanted] = await getColumns(`/api/scan?of=${encodeURIComponent(JSON.stringify({ ...scans.scan(), rate }))}`, 2);
    return { time, wanted };
  }
  const points = view[view.source];
  if (!points) throw new Error("Choose a file first.");
  return sampled(points, rate);
}

async function planNow() {
  const model = chosenModel();
  const asked = (view.asked += 1);
  try {
    const { limits, slew, rate } = options();
    const [compensator, path] = await Promise.all([compensatorOf(model, { limits, slew, period: 1 / rate }), wantedPath(rate)]);
    if (asked !== view.asked) return;
    const began = performance.now();
    const planned = plan(compensator, path.wanted);
    figures.draw({ path, planned, limits, band: bandOf(model), points: view.source === "points" ? view.points : null });
    view.took = performance.now() - began;
    describe(model, path, planned);
    say(problem, "");
  } catch (error) {
    if (asked === view.asked) cannotPlan(error.message);
  }
}

// Without a plan there is no verdict either: that of the path before is not this one's.
function cannotPlan(why) {
  say(problem, why);
  words.dataset.stamp = "";
  words.className = "plan outcome amber";
  const before = view.took === undefined ? "" : " The pictures show the path before.";
  words.replaceChildren(h("p", { class: "first" }, `This path has no voltage yet: see below its options.${before}`));
}

function describe(model, { time }, planned) {
  const { limited, slewed } = planned.clamps;
  const cut = [limited && `${whole(limited)} samples are cut at a limit`, slewed && `${whole(slewed)} are held back by the slew rate`].filter(Boolean);
  const stroke = model.range_um[1] - model.range_um[0];
  const share = percent((100 * planned.straightMissed) / stroke);
  const verdict = cut.length
    ? ["red", `${cut.join(" and ")}: the path is missed by up to ${length(planned.missed)}.`]
    : [lightOf(model.verdict)[0], `The path can be followed: expect it within ${length(bandOf(model))} (${percent(model.verdict.largest_percent)} of the stroke).`];
  const facts = [
    `${range(planned.range, "V", 3)}, at most ${short(planned.steepest)} V/s${speedWords(model, planned)}, ${whole(time.length)} samples in ${duration(time.at(-1) - time[0])}.`,
    `A straight gain would miss it by up to ${length(planned.straightMissed)} (${share} of the stroke).`,
  ];
  const remarks = remarksOf(model.verdict);
  const stamp = JSON.stringify([verdict, facts]);
  if (words.dataset.stamp === stamp) return;
  words.dataset.stamp = stamp;
  words.className = `plan outcome ${verdict[0]}`;
  const more = remarks.length ? [h("details", {}, h("summary", {}, "What the records of the model did not show"), h("ul", {}, remarks.map((one) => h("li", {}, one))))] : [];
  words.replaceChildren(h("p", { class: "first" }, verdict[1]), ...facts.map((one) => h("p", {}, one)), ...more);
}

// How fast the path is beside the records of the model. It is no line of its own: the picture below would jump while a
// point is dragged.
function speedWords({ slew_v_per_s: recorded }, { steepest, clamps }) {
  if (!recorded) return parsed(form.slew.value) === null ? " (not limited: the speed of the model's records is unknown)" : "";
  if (steepest > recorded * 1.001) return ` (${short(steepest / recorded)} times faster than anything recorded, ${short(recorded)} V/s)`;
  return clamps.slewed ? ` (recorded: up to ${short(recorded)} V/s)` : "";
}

async function writeVoltage() {
  await post(`/api/models/${chosenModel().id}/path`, currentRequest());
  announce("The voltage is being computed.");
}

// For measurements: how long the last plan and its pictures took (ms).
export const lastPlan = () => view.took;
export const currentRequest = () => {
  const { slew, ...others } = options();
  return { ...request[view.source](), ...others, slew: slew ?? "none" };
};
