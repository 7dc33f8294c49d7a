// What a calibration would play, as a table that is shown before anything is armed; and what came of it.
import { h, table } from "./dom.js";
import { duration, percent, short, whole } from "./numbers.js";

const HEADS = ["Step", { text: "What", class: "text" }, "Samples", "Time", "Lowest (V)", "Highest (V)", "Steepest (V/s)"];

export function planTable(plan) {
  const rows = plan.steps.map((one) => [
    String(one.step),
    h("td", { class: "text" }, one.what ?? ""),
    one.samples === undefined ? "" : whole(one.samples),
    duration(one.seconds),
    short(one.lowest_V),
    short(one.highest_V),
    short(one.steepest_V_per_s),
  ]);
  return [h("h3", {}, "What a calibration plays"), table("Plan of the calibration", HEADS, rows), h("p", { class: "muted" }, `It takes about ${duration(plan.seconds)} in all.`)];
}

export function resultBlock(result) {
  if (result.kind !== "calibration") return h("div", { class: "outcome green", role: "status" }, h("p", { class: "first" }, `Recorded ${whole(result.samples ?? 0)} samples.`));
  return h(
    "div",
    { class: `outcome ${result.good ? "green" : "amber"}`, role: "status" },
    h("strong", {}, result.good ? "Calibrated" : "Calibrated, with care"),
    h("b", {}, percent(result.compensated_percent), " ", h("small", {}, `of the stroke is the largest error on the measured path; ${percent(result.nominal_percent)} by a straight gain`)),
    result.warnings?.length > 0 && h("ul", {}, result.warnings.map((one) => h("li", {}, one))),
    result.command && h("details", {}, h("summary", {}, "The same in a terminal"), h("pre", {}, result.command)),
  );
}
