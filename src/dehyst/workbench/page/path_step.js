// The third step: a wanted path, its voltage (computed while the path is drawn), and the file that the server writes.
import { DECLARED } from "./declared.js";
import { Compensator, load } from "./dehyst.js";
import { h } from "./dom.js";
import { form as excitation } from "./excite.js";
import { COLOURS, MICROMETRES, SECONDS } from "./figure.js";
import { Form, fold, list, remarks, tick } from "./forms.js";
import { duration, length, limitsFrom, parsed, percent, plain, range, roundDown, short, whole } from "./numbers.js";
import { fastestBranch, plan, sampled } from "./path.js";
import { NO_PROMISE, PathFigures, TOO_FAST, curve, judged, verdict } from "./path_figures.js";
import { ScanForm } from "./scans.js";
import * as server from "./server.js";
import { fileLink, isOld, jobCards, lightOf, modelChoice } from "./verdict.js";

const { button, chosenModel, complain, problem, redraw } = server;

const SOURCES = { scan: "A scan", points: "Draw points", file: "A file" };
// A path has a promise up to ALIKE times the speed of the records; a voltage turns if it goes back by BAND of the
// range.
const [ALIKE, BAND] = [1.5, 0.02];
const view = { source: "scan", points: null, file: null, asked: 0, said: null, last: null };
const scans = new ScanForm(replan);
const form = new Form("path", DECLARED.forms.path, replan);
const figures = new PathFigures(usePoints);
const namesOf = (model) => (model.coupling ? model.axes.map((axis) => axis.name) : [""]);

export function pathView(state, model) {
  if (!model) return null;
  adopt(model);
  const { said } = view;
  const more = said?.remarks?.length > 0 && fold("What the records of the model did not show", list(said.remarks));
  return h("div.split", { key: "path-body" },
    h("div.side",
      modelChoice(),
      h("div.card",
        sourceChoice(model),
        { scan: scanFields, points: pointsField, file: fileField }[view.source](),
        form.row(model.coupling ? ["rate"] : ["low", "high", "slew", "rate"]),
        button("Write voltage", "path", write, { class: "main wide-button", id: "write" }),
        problem("path"),
      ),
      voltages(state),
    ),
    h("div.stage", said && verdict(said, more), figures.element),
  );
}

function sourceChoice(model) {
  const sources = Object.entries(SOURCES).filter(([name]) => !model.coupling || name === "file");
  const choice = ([value, label]) => {
    const onchange = () => {
      view.source = value;
      if (value === "points") view.points ??= firstPoints();
      replan();
    };
    return tick(label, { type: "radio", name: "source", value, checked: value === view.source, onchange });
  };
  return h("fieldset.row", h("legend", "The wanted path"), sources.map(choice));
}

const scanFields = () => h("div#source-scan", { key: "scan" }, scans.view());

function fileField() {
  const read = async (event) => {
    const [file] = event.target.files;
    if (!file) return;
    try {
      view.file = await server.readPath(chosenModel(), file);
      const [points] = view.file;
      const steps = points.slice(1, 1000).map((point, k) => point[0] - points[k][0]);
      form.values.rate = short(1 / Math.min(...steps), 6);
      replan();
    } catch (error) {
      view.file = null;
      cannotPlan(`${file.name}: ${error.message}`);
    }
  };
  return h("div.field", { key: "file" },
    h("label", { for: "path-file" }, "Table of time and displacement"),
    h("input#path-file", { type: "file", onchange: read }),
    h("small.hint", `columns such as time_s,${namesOf(chosenModel()).map((axis) => `${axis || "displacement"}_um`)}`),
  );
}

// The points of a drawn path as text, with one row for each point.
function pointsField() {
  const typed = (event) => {
    try {
      usePoints(typedPoints(event.target.value));
    } catch (error) {
      cannotPlan(error.message);
    }
  };
  const value = view.points.map((point) => point.map((number) => plain(number, 5)).join("  ")).join("\n");
  const about = { id: "points", rows: String(Math.min(view.points.length + 1, 12)), spellcheck: "false" };
  return h("div.field", { key: "points" },
    h("label", { for: "points" }, "Points: time (s) and displacement (\u00b5m)"),
    h("textarea", { ...about, value, onchange: typed }),
    h("small.hint", "Drag a point in the picture; a double click adds or removes one. Or type or paste points here."),
  );
}

function typedPoints(text) {
  const rows = text.split("\n").map((row) => row.trim()).filter(Boolean);
  const points = rows.map((row) => row.split(/[\s;]/.test(row) ? /[\s;]+/ : ",").map(parsed));
  const fits = (point, k) => point.length === 2 && point.every(Number.isFinite) && !(point[0] <= points[k - 1]?.[0]);
  const wrong = points.findIndex((point, k) => !fits(point, k));
  if (wrong >= 0) throw new Error(`Row ${wrong + 1}: got ${rows[wrong]}, need a later time, and a displacement.`);
  if (points.length < 2) throw new Error("Points: need two rows at least.");
  return points;
}

function usePoints(points) {
  view.points = points;
  replan();
}

// The largest speed of a suggested path, in reachable ranges a second: half of the speed of the records, because
// hysteresis makes a voltage steeper than its path.
function pace({ range_v: [low, high], slew_v_per_s: slew }) {
  return slew ? (0.5 * slew) / (high - low) : Infinity;
}

// The frequency of a suggested path, at most 1 Hz. Its first quarter moves by 0.55 of the range.
const frequency = (axis) => roundDown(Math.min(1, pace(axis) / 2.2));

// A path has at most ten thousand samples: then it can be planned while its points are dragged.
export const suggestedRate = (model) => plain(Math.min(1000, 10_000 * frequency(model)), 6);

function firstPoints() {
  const [low, high] = chosenModel().range_um;
  const seconds = 1 / frequency(chosenModel());
  return [0.2, 0.75, 0.35, 0.6, 0.2].map((share, k) => [(k / 4) * seconds, low + share * (high - low)]);
}

// Fill in suggestions when another model is chosen.
function adopt(model) {
  if (view.model === model.id) return;
  Object.assign(view, { model: model.id, file: null });
  if (model.coupling) {
    view.source = "file";
    figures.show(["path"]);
  }
  view.points = view.source === "points" ? firstPoints() : null;
  [form.values.low, form.values.high] = model.range_v.map((end) => plain(end, 6));
  form.values.slew = excitation.values.slew ?? "";
  form.values.rate = suggestedRate(model);
  scans.suggest(model.range_um, pace(model));
  replan();
}

// Plan again at the next frame, once for many changes.
function replan() {
  view.frame ??= requestAnimationFrame(() => {
    view.frame = undefined;
    planNow(chosenModel());
  });
  redraw();
}

// The points of each axis, from a file or drawn.
function chosenPaths() {
  if (view.source === "points") return [view.points];
  if (!view.file) throw new Error("Choose a file first.");
  return view.file;
}

const modules = new Map(); // compiled, by model and period

async function planNow(model) {
  const asked = (view.asked += 1);
  try {
    if (model.coupling) {
      view.said = planAxes(model);
      complain("path", "");
      return;
    }
    const { limits, slew, rate } = choices();
    const period = 1 / rate;
    const compiled = server.remembered(modules, `${model.id} ${period}`, () => load(server.wasmAddress(model, period)));
    const wanted =
      view.source === "scan" ? server.scanColumns({ ...scans.scan(), rate }) : sampled(chosenPaths()[0], rate);
    const [module, path] = await Promise.all([compiled, wanted]);
    if (asked !== view.asked) return;
    const planned = plan(new Compensator(module, { limits, slewRate: slew, period }), path.wanted);
    const points = view.source === "points" ? view.points : null;
    const line = view.source === "scan" ? 1 / (scans.scan().frequency ?? NaN) : NaN;
    const pace = paceOf(planned.voltage, rate, model);
    const why = (isOld(model) && NO_PROMISE) || (pace > ALIKE && TOO_FAST);
    const band = why ? 0 : model.verdict.largest_um;
    view.last = { path, planned, limits, points, line, reach: model.range_um, band, why, pace };
    figures.draw(view.last);
    view.said = described(model, view.last);
    complain("path", "");
  } catch (error) {
    if (asked === view.asked) cannotPlan(error.message);
  } finally {
    redraw();
  }
}

// Draw a path of several axes, without voltages, which depend on one another.
function planAxes(model) {
  const names = namesOf(model);
  const paths = chosenPaths();
  figures.handles.set([], model.range_um);
  const column = (k, at) => Float64Array.from(paths[k], (point) => point[at]);
  const series = names.map((name, k) => curve(name, COLOURS[k % COLOURS.length], column(k, 0), column(k, 1)));
  const spoken = `Wanted displacement of ${names.join(", ")} over time.`;
  figures.path.set({ x: SECONDS, y: MICROMETRES, series }, { spoken });
  const [light] = lightOf(model.verdict);
  const expected = model.axes.map(({ name }) => {
    const { largest_um: um, largest_percent: share } = model.coupling.verdicts[name];
    return `${name} within ${length(um)} (${percent(share)} of the stroke)`;
  });
  return {
    light,
    first: isOld(model) ? NO_PROMISE : `Expect ${expected.join(", ")}, ${model.verdict.apart}.`,
    facts: ["The voltages of coupled axes are computed when they are written, within the limits of the records."],
    remarks: model.verdict.remarks,
  };
}

// Show no verdict without a plan: the last verdict is that of another path.
function cannotPlan(why) {
  const before = view.last ? " The pictures show the last path." : "";
  view.said = { light: "amber", first: `This path has no voltage yet: the message below its options says why.${before}`, facts: [] };
  complain("path", why);
  redraw();
}

// The fastest branch of a voltage, as a multiple of the fastest one of the records.
const paceOf = (voltage, rate, { range_v: [low, high], fastest_v_per_s: fastest }) =>
  fastest ? (rate * fastestBranch(voltage, BAND * (high - low))) / fastest : NaN;

function described({ slew_v_per_s: recorded, verdict: known }, { planned, band, why, pace }) {
  const light = band ? lightOf(known)[0] : "amber";
  const slewed = recorded && planned.clamps.slewed ? ` (recorded: up to ${short(recorded)} V/s)` : "";
  const speed = pace > 1.001 ? ` (its fastest branch is ${short(pace)} times as fast as that of the records)` : slewed;
  return { ...judged(planned, { ...known, band, why, light, speed }), remarks: known.remarks };
}

function choices() {
  const { low, high } = form.values;
  return { limits: limitsFrom(low, high), slew: form.value("slew"), rate: form.value("rate") };
}

// The path as a request to the server.
function currentRequest() {
  const model = chosenModel();
  if (model.coupling) {
    const points = Object.fromEntries(namesOf(model).map((name, k) => [name, chosenPaths()[k]]));
    return { points, rate: form.value("rate") };
  }
  const { slew, ...others } = choices();
  const path = view.source === "scan" ? { scan: scans.scan() } : { points: chosenPaths()[0] };
  return { ...path, ...others, slew: slew ?? "none" };
}

// An async function: an error in the request is shown like an error of the server.
const write = async () =>
  server.workOn(chosenModel().id, "follow", currentRequest(), "The voltage is being computed.");

// The written voltages with their downloads, and the jobs that write a voltage.
function voltages(state) {
  const jobs = server.openJobs("compensate");
  if (!state.voltages.length && !jobs.length) return null;
  return h("section", { "aria-labelledby": "voltages-title", id: "voltages", key: "voltages" },
    h("h3#voltages-title", "Voltages written"),
    h("ul#voltage-jobs.cards", jobCards(jobs)),
    h("ul#voltage-list.cards", [...state.voltages].reverse().map(voltageCard)),
  );
}

function voltageCard({ id, name, file, range_v: ends, samples, seconds, model, clamped, words = [], ...more }) {
  const errors = (more.largest_um ?? []).map((um, k) => um && `${more.axes[k] ?? ""} ${length(um)}`.trim());
  const maker = server.modelOf(model)?.name ?? "a model that was removed";
  return h("li.card", { key: id },
    h("div.card-head", h("h3", name), fileLink(file, "Download CSV", { class: "button main" })),
    h("p", `${range(ends, "V")}, ${whole(samples)} samples in ${duration(seconds)}, by ${maker}.`),
    errors.some(Boolean) && h("p.muted", `Promised within ${errors.filter(Boolean).join(", ")}.`),
    clamped > 0 && h("p.muted", `${whole(clamped)} voltages are clamped.`),
    remarks(words),
  );
}
