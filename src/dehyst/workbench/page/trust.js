// The third step: how far to trust a model. Where its records turned, with the path of the next step and what is
// promised along it; and the assessment.
import { DECLARED } from "./declared.js";
import { fill, h, make } from "./dom.js";
import { Figure, MICROMETRES, SECONDS } from "./figure.js";
import { Form, card, fold, list } from "./forms.js";
import { length } from "./numbers.js";
import { turnsPicture, wantedCurves } from "./path_figures.js";
import { currentPlan } from "./path_step.js";
import { isPlane } from "./report.js";
import { button, openJobs, problem, readyRecords, workOn } from "./server.js";
import { goTo } from "./steps.js";
import { axesBlock, jobCards, modelChoice, mounted, verdictBlock } from "./verdict.js";

const promise = new Figure({ title: "The promise along your path", help: false });
const turns = make(h("div#trust-turns.report"));
let drawn = {}; // the plan in the pictures, and the figure with its turning points

export function trustView(_, model) {
  if (!model) return null;
  const jobs = openJobs("insight", model.id);
  const running = jobs.some((one) => one.status === "running");
  const { report } = model.insight ?? {};
  const assessment = report && mounted(report);
  // Those of several axes are in their assessment, without a path.
  fill(turns, model.coupling ? axesBlock(model) : turned(model));
  if (assessment && !model.coupling) assessed(assessment);
  return [
    modelChoice(),
    !assessment && verdictBlock(model),
    !assessment && turns,
    h("ul#trust-jobs.cards", jobCards(jobs)),
    h("div#trust-insight", assessment ? assessment.element : !report && invitation(model, running)),
    report && problem(report),
    problem("trust"),
    checkCard(model),
  ];
}

// Where the records of a model turned, from its report, with the path of the next step and the promise along it.
function turned(model) {
  const figure = mounted(model.report, "turns")?.figures.find(isPlane);
  if (!figure) return problem(model.report);
  const section = figure.element.closest("section");
  const beside = figure.element.parentElement;
  const plan = currentPlan();
  promise.element.hidden = !plan;
  if (beside.nextSibling !== promise.element) beside.after(promise.element);
  if (plan && (drawn.plan !== plan || drawn.figure !== figure)) drawPath(plan, figure);
  const none = ["There is no path yet. ", goTo("path", "To the path")];
  const words = h("p", plan ? plan.turned?.sentence : none);
  return [section.previousElementSibling, section, words];
}

// Put the turning points behind the first words of an assessment, in place of its own.
function assessed({ element, figures }) {
  const own = figures.find(isPlane)?.element.closest("section");
  if (own && element.contains(own)) {
    own.previousElementSibling.remove();
    own.remove();
  }
  const first = element.querySelector(".outcome");
  if (first.nextSibling !== turns) first.after(turns);
}

const invitation = ({ id }, running) =>
  card("What do the records leave open?", { key: "invitation" },
    h("p",
      "The assessment shows what the records leave open of a path, what to record next, and which numbers of the " +
        "model the records determine. It takes seconds to minutes.",
    ),
    button("Assess the model", "trust", () => workOn(id, "insight", {}, "The assessment has begun."), {
      class: "main",
      hidden: running,
    }),
  );

const checking = new Form("check", DECLARED.forms.check);

// Whether a model still holds, by a record that it was not identified from; and its update by that record.
function checkCard(model) {
  const { check } = model;
  const records = readyRecords().filter((one) => !model.train.includes(one.id));
  checking.offer("record", records.map((one) => [one.id, one.name]));
  const jobs = [...openJobs("check", model.id), ...openJobs("update", model.id)];
  const running = jobs.some((one) => one.status === "running");
  const act = (text, what, record, begun, look) =>
    button(text, "check", () => workOn(model.id, what, { record }, begun), { ...look, hidden: running });
  const measure = ["Measure one loop again now and then, and drop its record. ", goTo("records", "To the records")];
  return card("Is it still true?", { id: "check", key: "check" },
    records.length === 0 && h("p", measure),
    records.length > 0 && checking.field("record"),
    records.length > 0 && act("Check the model", "check", checking.values.record, "The check has begun."),
    h("ul.cards", jobCards(jobs)),
    problem("check"),
    check &&
      h("div", { class: `outcome ${check.good ? "green" : "amber"}`, role: "status", id: "check-result" },
        check.sentences.map((one) => h("p.first", one)),
        list(check.why),
        check.remarks.length > 0 && fold("What limits this check", list(check.remarks)),
        check.updates &&
          act("Update the model", "update", check.record, "The update has begun.", { class: "main" }),
      ),
  );
}

// Draw the path with its band, and where its voltage turns.
function drawPath(plan, figure) {
  const { band, turned: found } = plan;
  drawn = { plan, figure };
  if (found) figure.set(...turnsPicture(found));
  const notes = [["band", `expected largest error, \u00b1${length(band)}`]];
  const spoken = "The wanted path with the error to expect.";
  promise.set({ x: SECONDS, y: MICROMETRES, series: wantedCurves(plan), notes }, { spoken });
}
