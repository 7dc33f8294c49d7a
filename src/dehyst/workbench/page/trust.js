// How far to trust a model: the assessment by its training records, and the check by a new record.
import { DECLARED } from "./declared.js";
import { h } from "./dom.js";
import { Form, card, fold, list } from "./forms.js";
import { button, chooseModel, openJobs, problem, readyRecords, workOn } from "./server.js";
import { goTo } from "./steps.js";
import { jobCards, mounted } from "./verdict.js";

export function assessment({ id, insight }) {
  const jobs = openJobs("insight", id);
  const assess = () => workOn(id, "insight", {}, "The assessment has begun.");
  if (insight) {
    return [problem(insight.report), h("h2", "What the records do not determine"), h("div#insight", mounted(insight.report))];
  }
  return card("What do the records not determine?", { id: "assess", key: "assess" },
    h("p", "The assessment shows which loops no record tests, and what to record next. It takes seconds to minutes."),
    !jobs.some(runs) && button("Assess the model", "assess", assess, { class: "main" }),
    h("ul.cards", jobCards(jobs)),
    problem("assess"),
  );
}

const runs = ({ status }) => status === "running";

const checking = new Form("check", DECLARED.forms.check);

// The check of a model by a record other than its training records, and the update from that record.
export function checkCard(model) {
  const { check } = model;
  const records = readyRecords().filter((record) => !model.train.includes(record.id));
  checking.offer("record", records.map((record) => [record.id, record.name]));
  const jobs = [...openJobs("check", model.id), ...openJobs("update", model.id)];
  const act = (text, what, record, begun, look) => {
    const work = () => workOn(model.id, what, { record }, begun).then(() => what === "update" && chooseModel(""));
    return button(text, "check", work, { ...look, hidden: jobs.some(runs) });
  };
  return card("Is it still true?", { id: "check", key: "check" },
    check &&
      h("div", { class: `outcome ${check.good ? "green" : "amber"}`, role: "status", id: "check-result" },
        check.sentences.map((sentence) => h("p.first", sentence)),
        list(check.why),
        check.remarks.length > 0 && fold("What limits this check", list(check.remarks)),
        check.updates && act("Update the model", "update", check.record, "The update has begun.", { class: "main" }),
      ),
    records.length === 0 && h("p", "Measure a loop again now and then, and drop its record. ", goTo("records", "Records", "")),
    records.length > 0 && checking.field("record"),
    records.length > 0 && act("Check the model", "check", checking.values.record, "The check has begun."),
    h("ul.cards", jobCards(jobs)),
    problem("check"),
  );
}
