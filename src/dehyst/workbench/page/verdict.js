// What to expect of a model: first in words with a number and a colour, then why.
import { h } from "./dom.js";
import { inPage } from "./labels.js";
import { length, percent } from "./numbers.js";

const LIGHTS = {
  ready: ["green", "Ready for use"],
  usable: ["amber", "Usable, with care"],
  "not usable": ["red", "Not usable"],
};

export const readiness = (verdict) => String(verdict.readiness).toLowerCase().replaceAll("_", " ");
export const lightOf = (verdict) => LIGHTS[readiness(verdict)] ?? ["amber", String(verdict.readiness)];

export function verdictBlock(model) {
  const { verdict } = model;
  const [light, words] = lightOf(verdict);
  const reasons = (verdict.why ?? []).map(inPage);
  return h(
    "div",
    { class: `outcome ${light}`, role: "status", "aria-label": "Verdict" },
    h("strong", {}, words),
    h("b", {}, percent(verdict.largest_percent), " ", h("small", {}, `of the stroke (${length(verdict.largest_um)}) is the largest error to expect`)),
    h("p", {}, `RMS ${percent(verdict.rms_percent)}, from ${basis(verdict.basis)}; goal ${percent(verdict.goal)}.`),
    reasons.length > 0 && h("details", {}, h("summary", {}, reasons.length === 1 ? "One thing to know" : `${reasons.length} things to know`), h("ul", {}, reasons.map((one) => h("li", {}, one)))),
    remarksOf(verdict).length > 0 && h("ul", { class: "remarks" }, remarksOf(verdict).map((one) => h("li", {}, one))),
  );
}

// What the records did not show: it limits what the verdict is worth.
export const remarksOf = (verdict) => (verdict.remarks ?? []).map(inPage);

const basis = (text) => text || "the records";

// Half the width of the trust band, in micrometres: the largest error to expect.
export const bandOf = (model) => model?.verdict?.largest_um ?? 0;
