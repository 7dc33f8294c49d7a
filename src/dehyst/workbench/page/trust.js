// The third step: how far to trust a model. The assessment with the path of the next step in it: what is promised along
// it, and where it turns.
import { announce, button, problem } from "./acts.js";
import { assess } from "./api.js";
import { h } from "./dom.js";
import { Figure } from "./figure.js";
import { length } from "./numbers.js";
import { turnsPicture } from "./path_figures.js";
import { currentPlan } from "./path_step.js";
import { MICROMETRES, SECONDS_AXIS } from "./records.js";
import { chosenModel, openJobs } from "./state.js";
import { goTo, jobCards, modelChoice, mounted, needsModel, verdictBlock } from "./verdict.js";

const promise = new Figure({ title: "The promise along your path", help: false });
let drawn = null; // the plan in the pictures

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

function assessment({ insight }) {
  const parts = mounted(insight.report);
  const plan = currentPlan();
  promise.element.hidden = !plan;
  if (parts && promise.element.parentElement !== parts.element) {
    parts.element.querySelector(".outcome").after(promise.element);
    drawn = null;
  }
  if (parts && plan && drawn !== plan) drawPath(plan, parts);
  const none = h("p", {}, "There is no path yet. ", goTo("path", "To the path"));
  return [problem(insight.report), !plan && none, parts?.element];
}

// Draw the path with its band, and where its voltage turns.
function drawPath(plan, { figures }) {
  const { path, planned, band, tested } = plan;
  drawn = plan;
  const turns = figures.find((one) => one.title === "Turning points");
  if (tested) turns?.set(...turnsPicture(tested, planned.voltage));
  const curve = (name, colour, y, more) => ({ name, colour, x: path.time, y, rising: true, width: 1.8, ...more });
  const series = [curve("wanted", "measured", path.wanted, { around: band })];
  if (planned.clamps.limited + planned.clamps.slewed) series.push(curve("reached", "simulated", planned.reached));
  const notes = [["band", `expected largest error, \u00b1${length(band)}`]];
  const spoken = "The wanted path with the error to expect.";
  promise.set({ x: SECONDS_AXIS, y: MICROMETRES, series, notes }, { spoken });
}
