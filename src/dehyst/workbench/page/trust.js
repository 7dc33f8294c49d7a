// The third step: how far to trust a model. The assessment with the path of the next step in it: what is promised along
// it, and where it turns.
import { assess, reportText } from "./api.js";
import { h } from "./dom.js";
import { Figure } from "./figure.js";
import { announce, button, complain, problem } from "./forms.js";
import { length } from "./numbers.js";
import { turnsPicture } from "./path_figures.js";
import { currentPlan } from "./path_step.js";
import { MICROMETRES, SECONDS_AXIS } from "./records.js";
import { reportParts } from "./report.js";
import { chosenModel, openJobs, redraw } from "./state.js";
import { goTo, jobCards, modelChoice, needsModel, verdictBlock } from "./verdict.js";

const promise = new Figure({ title: "The promise along your path", help: false });
const assessed = { address: "", turns: null, parts: null }; // the assessment that is shown

export function trustView() {
  const heading = h("h2", { class: "unseen" }, "Trust");
  const model = chosenModel();
  if (!model) return [heading, needsModel("There is no model to assess yet.")];
  const jobs = openJobs("insight", model.id);
  const running = jobs.some((one) => one.status === "running");
  return [
    heading,
    modelChoice(),
    !model.insight?.report && verdictBlock(model),
    h("ul", { id: "trust-jobs", class: "cards" }, jobCards(jobs)),
    h("div", { id: "trust-insight" }, model.insight?.report ? assessment(model) : invitation(model, running)),
    problem("trust"),
  ];
}

const invitation = ({ id }, running) =>
  h(
    "div",
    { class: "card", key: "invitation" },
    h("h3", {}, "What do the records test?"),
    h(
      "p",
      {},
      "The assessment shows where the records turned and what that leaves open of your path, what to record next, " +
        "and which numbers of the model the records determine. It takes seconds to minutes.",
    ),
    button("Assess the model", "trust", () => start(id), { class: "main", hidden: running }),
  );

async function start(id) {
  await assess(id);
  announce("The assessment has begun.");
}

function assessment(model) {
  if (assessed.address !== model.insight.report) loadReport(model.insight.report);
  const plan = currentPlan();
  if (plan && assessed.drawn !== plan) drawPath(plan);
  promise.element.hidden = !plan;
  return [!plan && h("p", {}, "There is no path yet. ", goTo("path", "To the path")), assessed.parts];
}

async function loadReport(address) {
  Object.assign(assessed, { address, parts: null });
  try {
    const { element, figures } = reportParts(await reportText(address));
    const turns = figures.find((one) => one.title === "Turning points");
    Object.assign(assessed, { parts: element, turns, drawn: null });
    element.querySelector(".outcome").after(promise.element);
    redraw();
  } catch (error) {
    complain("trust", error.message);
  }
}

// Draw the path with its band, and where its voltage turns.
function drawPath(plan) {
  const { path, planned, band, tested } = plan;
  assessed.drawn = plan;
  if (tested) assessed.turns?.set(...turnsPicture(tested, planned.voltage));
  const curve = (name, colour, y, more) => ({ name, colour, x: path.time, y, rising: true, width: 1.8, ...more });
  const series = [curve("wanted", "measured", path.wanted, { around: band })];
  if (planned.clamps.limited + planned.clamps.slewed) series.push(curve("reached", "simulated", planned.reached));
  const notes = [["band", `expected largest error, \u00b1${length(band)}`]];
  const spoken = "The wanted path with the error to expect.";
  promise.set({ x: SECONDS_AXIS, y: MICROMETRES, series, notes }, { spoken });
}
