// The third step: how far to trust a model. What it rests on, and the assessment by `dehyst insight`.
import { post } from "./api.js";
import { action, announce, byId, errorPlace, h, keyed, show, table } from "./dom.js";
import { inPage } from "./labels.js";
import { goTo, modelChoice } from "./models.js";
import { duration, length, percent, short } from "./numbers.js";
import { chosenModel, jobsOf, watch } from "./state.js";
import { verdictBlock } from "./verdict.js";
import { jobCard } from "./voltages.js";

const SHOWN = 3; // excitations that are listed at once

export function buildTrust() {
  byId("trust").append(
    h("h2", { class: "unseen" }, "Trust"),
    h("div", { class: "empty", id: "trust-empty" }, h("p", {}, "There is no model to assess yet."), goTo("records", "To the records")),
    h("div", { id: "trust-body", hidden: true }, modelChoice(), h("div", { id: "trust-verdict" }), h("ul", { id: "trust-jobs", class: "cards" }), h("div", { id: "trust-insight" })),
  );
  watch("state", refresh);
}

function refresh() {
  const model = chosenModel();
  show(byId("trust-empty"), !model);
  show(byId("trust-body"), Boolean(model));
  if (!model) return;
  const job = jobsOf(model.id, "insight").at(-1);
  const jobs = job && ["running", "failed"].includes(job.status) ? [job] : [];
  keyed(byId("trust-verdict"), [{ id: model.id, verdict: model.verdict }], { create: (one) => h("div", {}, verdictBlock(one)) });
  keyed(byId("trust-jobs"), jobs, { create: jobCard });
  const item = { id: model.id, insight: model.insight, busy: job?.status === "running" };
  keyed(byId("trust-insight"), [item], { create: (one) => h("div", {}, one.insight ? assessment(one.insight, model) : invitation(one)) });
}

function invitation({ id, busy }) {
  const problem = errorPlace();
  const button = action(h("button", { type: "button", class: "main" }, "Assess the model"), problem, async () => {
    await post(`/api/models/${id}/insight`);
    announce("The assessment has begun.");
  });
  button.hidden = busy;
  return h(
    "div",
    { class: "card" },
    h("h3", {}, "What do the records determine?"),
    h("p", {}, "The assessment computes which stiffnesses the records determine, with intervals, from where on the actuator's state is known, and what to record next. It takes seconds to minutes."),
    button,
    problem,
  );
}

function assessment(insight, model) {
  const { known, warnings, advice, suggested, directions, homing } = insight;
  return [
    h(
      "div",
      { class: `outcome ${known?.all ? "green" : "amber"}` },
      h("strong", {}, known?.all ? "Determined" : "Partly determined"),
      h("p", { class: "first" }, known?.sentence ?? insight.not_judged ?? ""),
      [known?.others, known?.next].filter(Boolean).map((one) => h("p", {}, one)),
    ),
    section("To know", list(warnings)),
    (advice || suggested) && section("To record next", next(advice ?? [], suggested)),
    directions?.of && section("Directions", h("p", {}, `${directions.determined} of ${directions.of} directions are determined. ${(directions.sentences ?? []).join(" ")}`)),
    section("From when on the state is known", stateTable(insight.state)),
    section("Homing", homing && homingText(homing)),
    parts(insight.parts ?? [], insight.level),
    known?.rule && h("p", { class: "muted" }, known.rule),
    insight.misfit_m && h("p", { class: "muted" }, `Misfit of the model class: ${length(1e6 * insight.misfit_m)} of a stroke of ${length(1e6 * insight.stroke_m)}. Model ${model.name}.`),
  ];
}

const section = (title, content) => content && h("section", {}, h("h3", {}, title), content);
const list = (items) => (items?.length ? h("ul", {}, items.map((one) => h("li", {}, inPage(one)))) : null);

// Excitations that determine more, the best first, with the command that writes the voltage.
function next(advice, suggested) {
  if (!advice.length) return h("p", {}, suggested?.words ?? "No further record of this kind determines more.");
  const rows = (some) => some.map((one) => [h("td", { class: "text" }, one.words), duration(one.seconds), `${one.determined} of ${one.of}`, h("td", { class: "text" }, h("code", {}, one.command))]);
  const heads = [{ text: "Record", class: "text" }, "Time", "Directions then determined", { text: "Command that writes the voltage", class: "text" }];
  return [
    table("To record next", heads, rows(advice.slice(0, SHOWN))),
    advice.length > SHOWN && h("details", {}, h("summary", {}, `${advice.length - SHOWN} more`), table("More to record", heads, rows(advice.slice(SHOWN)))),
  ];
}

function stateTable(rows) {
  if (!rows?.length) return null;
  const when = (seconds) => (seconds === null ? "never" : `after ${short(seconds)} s`);
  return table(
    "From when on the state is known",
    ["Record", "by the displacement", "by the voltage alone"],
    rows.map((one) => [one.record, when(one.known_by_displacement_s), when(one.known_by_voltage_s)]),
  );
}

function homingText({ turns_V: turns, certified, remarks = [] }) {
  const route = turns.map((one) => short(one)).join(", ");
  return [h("p", {}, `Voltages ${route} V bring the actuator to one state${certified ? "" : ", which is not certified"}.`), list(remarks)];
}

function parts(list, level) {
  return list
    .filter((one) => one.estimate?.length)
    .map((one) =>
      h(
        "details",
        {},
        h("summary", {}, `${one.part}: ${one.known} of ${one.of} known`),
        table(`Numbers of the ${one.part}`, ["Number", `Estimate (${one.unit})`, `${percent(100 * level)} interval (${one.unit})`, { text: "Known?", class: "text" }], partRows(one)),
      ),
    );
}

function partRows({ estimate, interval, words }) {
  const [low, high] = interval ?? [];
  const between = (k) => (low?.[k] === undefined ? "\u2013" : `${short(low[k])} to ${short(high[k])}`);
  return estimate.map((value, k) => [String(k + 1), short(value), between(k), h("td", { class: "text" }, words?.[k] ?? "")]);
}
