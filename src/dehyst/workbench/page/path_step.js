// The fourth step: a wanted path, the voltage for it as it is drawn, and the file that the server writes.
import { announce, button, complain, problem } from "./acts.js";
import { remembered, scanColumns, wasmAddress, writeVoltage } from "./api.js";
import { Compensator, load } from "./dehyst.js";
import { h } from "./dom.js";
import { Form, fold, list } from "./forms.js";
import { inPage } from "./labels.js";
import { duration, limitsFrom, plain, range, roundDown, short, whole } from "./numbers.js";
import { plan, sampled } from "./path.js";
import { PathFigures, judged, turnsOf, verdict } from "./path_figures.js";
import { parsedPath } from "./path_file.js";
import { isPlane } from "./report.js";
import { ScanForm } from "./scans.js";
import { chosenModel, modelOf, openJobs, redraw } from "./state.js";
import { bandOf, fileLink, jobCards, lightOf, modelChoice, needsModel, remarksOf, reportOf } from "./verdict.js";

const SOURCES = { scan: "A scan", points: "Draw points", file: "A file" };
const view = { source: "scan", points: null, file: null, asked: 0, said: null, last: null };
const scans = new ScanForm(replan);
const form = new Form(
  "path",
  {
    low: { label: "Lowest voltage", unit: "V" },
    high: { label: "Highest voltage", unit: "V" },
    slew: { label: "Largest slew rate", unit: "V/s", placeholder: "none", optional: true, above: 0 },
    rate: { label: "Samples a second", unit: "Hz", value: "1000", above: 0 },
  },
  replan,
);
const figures = new PathFigures(usePoints);

export function pathView(state) {
  const heading = h("h2", { class: "unseen" }, "Path and voltage");
  const model = chosenModel();
  if (!model) return [heading, needsModel("A path needs a model that is ready.")];
  adopt(model);
  const { said } = view;
  const more = said?.remarks?.length > 0 && fold("What the records of the model did not show", list(said.remarks));
  return [
    heading,
    h(
      "div",
      { class: "split", key: "path-body" },
      h(
        "div",
        { class: "side" },
        modelChoice(),
        h(
          "div",
          { class: "card" },
          sourceChoice(),
          { scan: scanFields, points: pointsField, file: fileField }[view.source](),
          form.row(["low", "high", "slew", "rate"]),
          button("Write voltage", "path", write, { class: "main wide-button", id: "write" }),
          problem("path"),
        ),
        voltages(state),
      ),
      h("div", { class: "stage" }, said && verdict(said, more), figures.element),
    ),
  ];
}

function sourceChoice() {
  const one = ([value, label]) => {
    const onchange = () => {
      view.source = value;
      if (value === "points") view.points ??= firstPoints();
      replan();
    };
    const input = h("input", { type: "radio", name: "source", value, checked: value === view.source, onchange });
    return h("label", { class: "tick" }, input, label);
  };
  return h("fieldset", { class: "row" }, h("legend", {}, "The wanted path"), Object.entries(SOURCES).map(one));
}

const scanFields = () => h("div", { id: "source-scan", key: "scan" }, scans.view());

function fileField() {
  const read = async (event) => {
    const [file] = event.target.files;
    if (!file) return;
    try {
      view.file = parsedPath(await file.text());
      const steps = view.file.slice(1, 1000).map((one, k) => one[0] - view.file[k][0]);
      form.values.rate = short(1 / Math.min(...steps), 6);
      replan();
    } catch (error) {
      view.file = null;
      cannotPlan(`${file.name}: ${error.message}`);
    }
  };
  return h(
    "div",
    { class: "field", key: "file" },
    h("label", { for: "path-file" }, "Table of time and displacement"),
    h("input", { type: "file", accept: ".csv,.txt,.dat,.tsv", id: "path-file", onchange: read }),
    h("small", { class: "hint" }, "columns such as time_s,displacement_um"),
  );
}

// The points of a drawn path as text, a row a point.
function pointsField() {
  const typed = (event) => {
    try {
      usePoints(parsedPath(event.target.value));
    } catch (error) {
      cannotPlan(error.message);
    }
  };
  const value = view.points.map((point) => point.map((one) => plain(one, 5)).join("  ")).join("\n");
  const about = { id: "points", rows: String(Math.min(view.points.length + 1, 12)), spellcheck: "false" };
  return h(
    "div",
    { class: "field", key: "points" },
    h("label", { for: "points" }, "Points: time (s) and displacement (\u00b5m)"),
    h("textarea", { ...about, value, onchange: typed }),
    h("small", { class: "hint" }, "Drag the points in the picture, or type or paste here."),
  );
}

function usePoints(points) {
  view.points = points;
  replan();
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
  return [0.2, 0.75, 0.35, 0.6, 0.2].map((share, k) => [(k / 4) * seconds, low + share * (high - low)]);
}

// Begin with suggestions for a model that was not chosen before.
function adopt(model) {
  if (view.model === model.id) return;
  view.model = model.id;
  view.points = view.source === "points" ? firstPoints() : null;
  [form.values.low, form.values.high] = model.range_v.map((one) => plain(one, 6));
  form.values.slew = model.slew_v_per_s ? plain(model.slew_v_per_s, 6) : "";
  scans.suggest(model.range_um, pace(model));
  replan();
}

// Plan again at the next frame: many changes at once are one.
function replan() {
  view.frame ??= requestAnimationFrame(() => {
    view.frame = undefined;
    planNow(chosenModel());
  });
  redraw();
}

async function wantedPath(rate) {
  if (view.source === "scan") return scanColumns({ ...scans.scan(), rate });
  const points = view[view.source];
  if (!points) throw new Error("Choose a file first.");
  return sampled(points, rate);
}

const modules = new Map(); // by model and period: compiled

async function planNow(model) {
  const asked = (view.asked += 1);
  try {
    const { limits, slew, rate } = choices();
    const period = 1 / rate;
    const compiled = remembered(modules, `${model.id} ${period}`, () => load(wasmAddress(model, period)));
    const [module, path, report] = await Promise.all([compiled, wantedPath(rate), reportOf(model.report)]);
    if (asked !== view.asked) return;
    const began = performance.now();
    const planned = plan(new Compensator(module, { limits, slewRate: slew, period }), path.wanted);
    const points = view.source === "points" ? view.points : null;
    const turned = turnsOf(report.figures.find(isPlane)?.spec, path.time, planned.voltage);
    view.last = { path, planned, limits, reach: model.range_um, band: bandOf(model), points, turned };
    figures.draw(view.last);
    view.took = performance.now() - began;
    view.said = described(model, view.last);
    complain("path", "");
  } catch (error) {
    if (asked === view.asked) cannotPlan(error.message);
  }
  redraw();
}

// Without a plan there is no verdict either: that of the path before is not this one's.
function cannotPlan(why) {
  const before = view.last ? " The pictures show the path before." : "";
  view.said = { light: "amber", first: `This path has no voltage yet: see below its options.${before}`, facts: [] };
  complain("path", why);
  redraw();
}

function described({ slew_v_per_s: recorded, verdict: known }, { planned, reach, band, turned }) {
  const { steepest, clamps } = planned;
  const [light] = lightOf(known);
  let speed = "";
  const free = form.values.slew.trim() === "";
  if (!recorded && free) speed = " (not limited: the speed of the model's records is unknown)";
  else if (recorded && steepest > recorded * 1.001) {
    speed = ` (${short(steepest / recorded)} times faster than anything recorded, ${short(recorded)} V/s)`;
  } else if (recorded && clamps.slewed) speed = ` (recorded: up to ${short(recorded)} V/s)`;
  const said = judged(planned, { stroke: reach[1] - reach[0], band, light, speed, turned });
  return { ...said, remarks: remarksOf(known) };
}

// Limits, slew rate and sample rate as they are typed.
function choices() {
  const { low, high } = form.values;
  return { limits: limitsFrom(low, high), slew: form.number("slew"), rate: form.number("rate") };
}

// The path as the server takes it.
export function currentRequest() {
  const { slew, ...others } = choices();
  const path = view.source === "scan" ? { scan: scans.scan() } : { points: view[view.source] };
  return { ...path, ...others, slew: slew ?? "none" };
}

// What is planned at present, for the pictures of other steps; null if there is nothing yet.
export function currentPlan() {
  adopt(chosenModel());
  return view.said?.light === "amber" && !view.said.facts.length ? null : view.last;
}
// For measurements: how long the last plan and its pictures took (ms).
export const lastPlan = () => view.took;

async function write() {
  await writeVoltage(chosenModel().id, currentRequest());
  announce("The voltage is being computed.");
}

// The voltages that were written, with their downloads, and the jobs that write one.
function voltages(state) {
  const jobs = openJobs("compensate");
  if (!state.voltages.length && !jobs.length) return null;
  return h(
    "section",
    { "aria-labelledby": "voltages-title", id: "voltages", key: "voltages" },
    h("h3", { id: "voltages-title" }, "Voltages written"),
    h("ul", { id: "voltage-jobs", class: "cards" }, jobCards(jobs)),
    h("ul", { id: "voltage-list", class: "cards" }, [...state.voltages].reverse().map(voltageCard)),
  );
}

function voltageCard({ id, name, file, range_v: ends, samples, seconds, model, clamped, words = [] }) {
  const [first, ...others] = words.map(inPage);
  const maker = modelOf(model)?.name ?? "a model that was removed";
  const summary = others.length === 1 ? "One more thing to know" : `${others.length} more things to know`;
  return h(
    "li",
    { class: `card ${clamped > 0 ? "refused" : ""}`, key: id },
    h("div", { class: "card-head" }, h("h3", {}, name), fileLink(file, "Download CSV", { class: "button main" })),
    h("p", {}, `${range(ends, "V")}, ${whole(samples)} samples in ${duration(seconds)}, by ${maker}.`),
    clamped > 0 && h("p", { class: "error" }, `${whole(clamped)} voltages are clamped: the path is missed there.`),
    first && list([first], "remarks"),
    others.length > 0 && fold(summary, list(others, "remarks")),
  );
}
