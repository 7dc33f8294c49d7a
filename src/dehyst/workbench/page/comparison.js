// Models of one record side by side: a table, and their residuals on that record in one picture.
import { Figure } from "./figure.js";
import { h, keyed, table } from "./dom.js";
import { residualsOf, traceColumns, tracesOf, withGaps } from "./fit_figure.js";
import { duration, length, percent } from "./numbers.js";
import { isOpen } from "./steps.js";
import { bandOf, lightOf } from "./verdict.js";

const COLOURS = ["measured", "simulated", "rising", "falling", "third", "fourth"];

// The record on which a model is compared: held out if there is one.
const recordFor = (model) => model.validate[0] ?? model.train[0];
const uses = (model) => [...model.train, ...model.validate];
// A smaller error is a better one only on the same records.
const sameRecords = (models) => new Set(models.map((one) => `${[...one.train].sort()} ${[...one.validate].sort()}`)).size === 1;

export function comparisonRows(models) {
  const best = (of) => (sameRecords(models) ? Math.min(...models.map(of)) : NaN);
  const [largest, rms] = [(one) => one.verdict.largest_percent, (one) => one.verdict.rms_percent];
  return models.map((one) => [
    one.name,
    light(one),
    marked(percent(largest(one)), largest(one) === best(largest)),
    length(one.verdict.largest_um),
    marked(percent(rms(one)), rms(one) === best(rms)),
    one.options?.structure ?? "auto",
    duration(one.seconds),
    one.verdict.basis ?? "",
  ]);
}

const marked = (text, best) => h("td", best ? { class: "best" } : {}, text, best && h("span", { class: "unseen" }, " (best)"));

function light(model) {
  const [colour, words] = lightOf(model.verdict);
  return h("td", { class: "text" }, h("span", { class: `light ${colour}` }, words));
}

export class ComparisonFigure {
  constructor() {
    this.figure = new Figure({ title: "Residuals" });
    this.rows = h("div", {});
    this.element = h("section", { class: "comparison", "aria-labelledby": "comparison", hidden: true }, h("h2", { id: "comparison" }, "Models side by side"), this.rows, this.figure.element);
  }

  async draw(all, chosen) {
    const record = recordFor(chosen);
    const models = all.filter((one) => uses(one).includes(record));
    this.element.hidden = models.length < 2;
    if (models.length < 2 || !isOpen("model")) return;
    const stamp = [chosen, ...models].map((one) => one.id).join(" ");
    keyed(this.rows, [{ id: "rows", models: models.map(({ id, verdict }) => [id, verdict]) }], {
      create: () => h("div", {}, table("Error, verdict and time of each model", ["Model", { text: "Verdict", class: "text" }, "Largest error", "Largest error", "RMS error", "Structure", "Time taken", "From"], comparisonRows(models))),
    });
    if (this.stamp === stamp) return;
    this.stamp = stamp;
    try {
      const at = (one) => uses(one).indexOf(record);
      const series = await Promise.all(models.map((one, k) => this.series(one, at(one), COLOURS[k % COLOURS.length])));
      if (this.stamp !== stamp) return;
      const half = 1e3 * bandOf(chosen);
      this.figure.set({
        x: { label: "Time (s)", unit: "s" },
        y: { label: "Measured \u2212 simulated (nm)", unit: "nm" },
        zero: true,
        band: [-half, half],
        series,
        notes: [["band", `expected largest error of ${chosen.name}`]],
      });
    } catch (error) {
      this.stamp = null;
      this.figure.output.textContent = error.message;
    }
  }

  async series(model, number, colour) {
    // Traces are in the order of the records, training first.
    const trace = (await tracesOf(model))[number];
    const data = await traceColumns(trace);
    return { key: model.id, name: `${model.name} on ${trace.name}`, colour, x: data.time, y: withGaps(residualsOf(data), data.time, trace.shaded), rising: true };
  }
}
