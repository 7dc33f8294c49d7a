// The third step: a wanted path, its voltage (computed while the path is drawn), and the file that the server writes.
import { DECLARED } from "./declared.js";
import { Compensator, load } from "./dehyst.js";
import { h } from "./dom.js";
import { given } from "./excite.js";
import { COLOURS, MICROMETRES, SECONDS } from "./figure.js";
import { Form, facts, list, tick } from "./forms.js";
import { bytes, duration, length, limitsFrom, parsed, percent, plain, range, roundDown, short, whole } from "./numbers.js";
import { fastestBranch, plan, sampled } from "./path.js";
import { NO_PROMISE, PathFigures, TOO_FAST, curve, judged, verdict } from "./path_figures.js";
import { ScanForm } from "./scans.js";
import * as server from "./server.js";
import { fileLink, isOld, jobCards, lightOf, modelChoice } from "./verdict.js";

const { button, chosenModel, complain, problem, redraw, session } = server;

const SOURCES = { scan: "A scan", points: "Draw points", file: "A file" };
// A path has a promise up to ALIKE times the speed of the records; a voltage turns if it goes back by BAND of the
// range.
const [ALIKE, BAND] = [1.5, 0.02];
const view = { source: "scan", points: null, file: null, asked: 0, said: null, written: 0 };
const scans = new ScanForm("scan", DECLARED.forms.scan, replan);
const form = new Form("path", DECLARED.forms.path, replan);
const figures = new PathFigures(usePoints);
const namesOf = (model) => (model.coupling ? model.axes.map((axis) => axis.name) : [""]);

export function pathView(state, model) {
  if (!model) return null;
  adopt(model, state);
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
    h("div.stage", view.said && verdict(view.said), figures.element),
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
      view.name = `${file.name}, ${bytes(file.size)}, ${new Date(file.lastModified).toLocaleString()}`;
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

// Limits within those of a model and those that the user gave for the stage, as values of the form.
export function bounds({ range_v: known }, state) {
  const { low = "", high = "", slew = "" } = given(state);
  const both = [Math.max(known[0], parsed(low) ?? -Infinity), Math.min(known[1], parsed(high) ?? Infinity)];
  const ends = (both[0] < both[1] ? both : known).map((end) => plain(end, 6));
  return { low: ends[0], high: ends[1], slew };
}

// When another model is chosen, fill in the last path that was written with its records, or suggestions.
function adopt(model, state) {
  const { voltages } = state;
  // A file that was written for this path has a promise of its own.
  if (view.written !== voltages.length) replan();
  view.written = voltages.length;
  if (view.model === model.id) return;
  Object.assign(view, { model: model.id, file: null });
  if (model.coupling) {
    view.source = "file";
    figures.show(["path"]);
  }
  const last = voltages.findLast((own) => String(server.modelOf(own.model)?.train) === String(model.train))?.asked;
  form.fill({ ...bounds(model, state), rate: suggestedRate(model), ...last });
  scans.suggest(model.range_um, pace(model));
  scans.fill(last?.scan ?? {});
  // The points of a file are not kept: the user chooses it again.
  if (last && !model.coupling) view.source = last.scan ? "scan" : last.file ? "file" : "points";
  view.points = last?.points ?? (view.source === "points" ? firstPoints() : null);
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
    const request = currentRequest(model);
    const file = written(model, request);
    if (model.coupling) view.said = planAxes(model, request.points, file);
    else await planOne(model, request, file, () => asked === view.asked);
    if (asked === view.asked) complain("path", "");
  } catch (error) {
    if (asked === view.asked) cannotPlan(error.message);
  } finally {
    redraw();
  }
}

// Draw a path with its voltage, while it is the `present` one, with the promise of its written file or of any path.
async function planOne(model, { scan, points, low, high, slew, rate }, file, present) {
  const period = 1 / rate;
  const compiled = server.remembered(modules, `${model.id} ${period}`, () => load(server.wasmAddress(model, period)));
  const wanted = scan ? server.scanColumns({ ...scan, rate }) : sampled(points, rate);
  const [module, path] = await Promise.all([compiled, wanted]);
  if (!present()) return;
  const planned = plan(new Compensator(module, { limits: [low, high], slewRate: slew, period }), path.wanted);
  const { verdict: known, fastest_v_per_s: fastest, range_v: volts, range_um: reach } = model;
  const promise = file?.promises[0] ?? known;
  // The fastest branch of the voltage, as a multiple of the fastest one of the records.
  const pace = fastest ? (rate * fastestBranch(planned.voltage, BAND * (volts[1] - volts[0]))) / fastest : NaN;
  const why = (isOld(model) && NO_PROMISE) || (pace > ALIKE && !file && TOO_FAST);
  const band = why ? 0 : promise.largest_um;
  const [line, handles] = [1 / (scan?.frequency ?? NaN), view.source === "points" ? points : null];
  figures.draw({ path, planned, limits: [low, high], reach, band, line, points: handles });
  const above = known.readiness === "READY" && promise.largest_percent > known.goal;
  const light = !band || above ? "amber" : lightOf(known)[0];
  const speed = pace > 1.001 ? ` (its fastest branch is ${short(pace)} times as fast as that of the records)` : "";
  view.said = judged(planned, { ...promise, band, why, light, speed, file: file?.file });
}

// Draw a path of several axes, without voltages, which depend on one another.
function planAxes(model, points, file) {
  figures.handles.set([], model.range_um);
  const column = (path, at) => Float64Array.from(path, (point) => point[at]);
  const series = Object.entries(points).map(([name, path], k) =>
    curve(name, COLOURS[k % COLOURS.length], column(path, 0), column(path, 1)),
  );
  const spoken = `Wanted displacement of ${Object.keys(points).join(", ")} over time.`;
  figures.path.set({ x: SECONDS, y: MICROMETRES, series }, { spoken });
  const [light] = lightOf(model.verdict);
  const expected = model.axes.map(({ name }, k) => {
    const { largest_um: um, largest_percent: share } = file?.promises[k] ?? model.coupling.verdicts[name];
    return `${name} within ${length(um)} (${percent(share)} of the stroke)`;
  });
  return {
    light,
    first: isOld(model) ? NO_PROMISE : `Expect ${expected.join(", ")}, ${model.verdict.apart}.`,
    facts: ["The voltages of coupled axes are computed when they are written, within the limits of the records."],
  };
}

// Show no verdict without a plan: the last verdict is that of another path.
function cannotPlan(why) {
  view.said = { light: "amber", first: "This path has no voltage yet: the message below its options says why.", facts: [] };
  complain("path", why);
  redraw();
}

// The path and its limits, as a request to the server.
function currentRequest(model) {
  const others = { ...(view.source === "file" && { file: view.name }), rate: form.value("rate") };
  if (model.coupling) {
    return { points: Object.fromEntries(namesOf(model).map((name, k) => [name, chosenPaths()[k]])), ...others };
  }
  const [low, high] = limitsFrom(form.values.low, form.values.high);
  const path = view.source === "scan" ? { scan: scans.scan() } : { points: chosenPaths()[0] };
  return { ...path, ...others, low, high, slew: form.value("slew") };
}

// The last voltage that was written for the path of a request.
function written(model, request) {
  const path = ({ scan, points, file, low, high, slew, rate }) =>
    JSON.stringify([file ?? scan ?? points, low, high, slew, rate]);
  return session.state.voltages.findLast((own) => own.model === model.id && path(own.asked) === path(request));
}

// An async function: an error in the request is shown like an error of the server.
const write = async () =>
  server.workOn(chosenModel().id, "follow", currentRequest(chosenModel()), "The voltage is being computed.");

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

function voltageCard({ id, name, file, range_v: ends, samples, seconds, model, words, promises, axes, asked }) {
  const path = asked.file ?? (asked.points && `drawn, ${asked.points.length} points`);
  const errors = promises.map((promise, k) => promise && `${axes[k] ?? ""} ${length(promise.largest_um)}`.trim());
  return h("li.card", { key: id },
    h("div.card-head", h("h3", name), fileLink(file, "Download CSV", { class: "button main" })),
    facts([
      ...(asked.scan ? scans.rows(asked.scan) : [["Path", path]]),
      ...form.rows(asked),
      ["Voltage", `${range(ends, "V")}, ${whole(samples)} samples in ${duration(seconds)}`],
      ["Promise", errors.some(Boolean) ? `within ${errors.filter(Boolean).join(", ")}` : undefined],
      ["Model", server.modelOf(model)?.name ?? "removed"],
      ["In the folder", file],
    ]),
    list(words, "remarks"),
  );
}
