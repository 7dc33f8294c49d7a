// A chart with what belongs to it: heading, views to choose from, legend, read-out, the way back to the whole.
import { Chart } from "./chart.js";
import { h, say, show } from "./dom.js";

const KEYS =
  "Keys: arrows move, plus and minus zoom, 0 shows all. Pointer: drag a box or turn the wheel to zoom; drag with Shift " +
  "or the middle button to move; double-click shows all.";

export class Figure {
  // `views` are [name, title] pairs; `choose` is called with the name of the view that the person chose.
  constructor({ title, label = title, views = [], choose = () => {}, tall = false, keys = KEYS }) {
    this.hidden = new Set();
    this.view = views[0]?.[0];
    this.buttons = views.map(([name, text]) =>
      h("button", { type: "button", class: "view", "aria-pressed": String(name === this.view), onclick: () => this.pick(name) }, text),
    );
    this.names = views.map(([name]) => name);
    this.choose = choose;
    this.heading = h("h3", {}, title);
    this.legend = h("ul", { class: "legend" });
    this.output = h("output", { class: "readout", "aria-live": "off" });
    this.reset = h("button", { type: "button", class: "reset", hidden: true }, "Show all");
    const holder = h("div", { class: tall ? "chart tall" : "chart" });
    const help = h("details", { class: "keys" }, h("summary", {}, "How to move in this picture"), h("p", {}, keys));
    this.element = h(
      "figure",
      { class: "figure" },
      h("div", { class: "figure-head" }, this.heading, h("div", { class: "views", role: "group", "aria-label": "View" }, this.buttons), this.reset),
      this.legend,
      holder,
      h("div", { class: "figure-foot" }, this.output, help),
    );
    this.chart = new Chart(holder, {
      label: `${label}. ${KEYS}`,
      readout: (text) => say(this.output, text),
      moved: (away) => show(this.reset, away),
    });
    this.reset.addEventListener("click", () => {
      this.chart.show(this.chart.home);
      this.chart.top.focus();
    });
  }

  pick(name) {
    if (this.view === name) return;
    this.view = name;
    this.buttons.forEach((button, k) => button.setAttribute("aria-pressed", String(this.names[k] === name)));
    this.choose(name);
  }

  // Show curves; those that the person took out of the legend stay out.
  set(spec, options) {
    this.spec = spec;
    this.options = options;
    for (const one of spec.series) one.hidden = this.hidden.has(one.key ?? one.name);
    this.chart.set(spec, options);
    if (!options?.keep) show(this.reset, false);
    this.writeLegend(spec);
  }

  // A sentence instead of a picture for those who do not see it.
  describe(text) {
    this.chart.top.setAttribute("aria-label", `${text} ${KEYS}`);
  }

  writeLegend({ series, notes = [] }) {
    const named = series.filter((one) => one.name && !one.silent);
    const stamp = JSON.stringify([named.map((one) => [one.key, one.name, one.colour, one.hidden]), notes]);
    if (this.stamp === stamp) return;
    this.stamp = stamp;
    const focused = this.legend.contains(document.activeElement) ? document.activeElement.dataset.series : null;
    this.legend.replaceChildren(
      ...named.map((one) => h("li", {}, this.legendKey(one))),
      ...notes.map(([kind, text]) => h("li", { class: "note" }, h("i", { class: `swatch ${kind}` }), text)),
    );
    if (focused) this.legend.querySelector(`[data-series="${CSS.escape(focused)}"]`)?.focus();
  }

  legendKey(one) {
    const key = one.key ?? one.name;
    const toggle = () => {
      if (this.hidden.has(key)) this.hidden.delete(key);
      else this.hidden.add(key);
      this.set(this.spec, { keep: true });
    };
    return h(
      "button",
      { type: "button", class: "series", "aria-pressed": String(!one.hidden), "data-series": key, onclick: toggle },
      h("i", { class: `swatch ${one.colour}` }),
      one.name,
    );
  }
}
