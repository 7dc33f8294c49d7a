// A chart with heading, choice of views, legend, read-out, and a button that shows all again.
import { Chart } from "./chart.js";
import { fill, h, make } from "./dom.js";
import { KEYS } from "./gestures.js";

export const SECONDS = { label: "Time (s)", unit: "s" };
export const VOLTS = { label: "Voltage (V)", unit: "V" };
export const MICROMETRES = { label: "Displacement (\u00b5m)", unit: "\u00b5m" };

// Names of the colours of several curves; style.css has their values.
export const COLOURS = ["measured", "simulated", "rising", "falling", "third", "fourth"];

export class Figure {
  // `views` are [name, title] pairs; `choose` is called with the name of the chosen view. `more` is shown after the
  // title.
  constructor({ title, label = title, views = [], choose = () => {}, tall = false, keys = KEYS, more }) {
    Object.assign(this, { title, views, choose, more, keys, hidden: new Set(), view: views[0]?.[0] });
    this.holder = make(h("div", { class: tall ? "chart tall" : "chart" }));
    this.chart = new Chart(this.holder, {
      label: `${label}. ${KEYS}`,
      readout: (text) => {
        this.output.textContent = text;
      },
      moved: () => this.write(),
    });
    this.chart.top.title = keys;
    this.output = make(h("output.readout", { "aria-live": "off" }));
    this.element = make(h("figure.figure"));
    this.write();
  }

  // Show curves; curves that the user has hidden stay hidden. `spoken` is a sentence for screen readers.
  set(spec, { spoken, ...options } = {}) {
    this.spec = spec;
    for (const series of spec.series) series.hidden = this.hidden.has(series.key ?? series.name);
    this.chart.set(spec, options);
    if (spoken) this.chart.top.setAttribute("aria-label", `${spoken} ${this.keys}`);
    this.write();
  }

  write() {
    const { chart, spec } = this;
    const reset = () => {
      chart.show(chart.home);
      chart.top.focus();
    };
    const view = ([name, text]) => {
      const pressed = String(name === this.view);
      const onclick = () => {
        this.view = name;
        this.choose(name);
        this.write();
      };
      return h("button", { type: "button", class: "view", "aria-pressed": pressed, onclick }, text);
    };
    const views = this.views.map(view);
    fill(
      this.element,
      h("div.figure-head",
        this.title && h("h3", this.title),
        this.more,
        views.length > 0 && h("div.views", { role: "group", "aria-label": "View" }, views),
        h("button", { type: "button", class: "reset", hidden: chart.view === chart.home, onclick: reset }, "Show all"),
      ),
      h("ul.legend", spec && this.legend(spec)),
      this.holder,
      this.output,
    );
  }

  // Series with the same name have one entry, which shows and hides all of them.
  legend({ series, notes = [] }) {
    const listed = series.filter((line) => line.name && !line.silent);
    const named = new Map(listed.map((line) => [line.key ?? line.name, line]));
    const toggle = (key) => {
      if (!this.hidden.delete(key)) this.hidden.add(key);
      this.set(this.spec, { keep: true });
    };
    const button = ([key, line]) =>
      h("button", { type: "button", class: "series", "aria-pressed": String(!line.hidden), onclick: () => toggle(key) },
        swatch(line.colour),
        line.name,
      );
    return [
      ...[...named].map((entry) => h("li", { key: entry[0] }, button(entry))),
      ...notes.map(([colour, text]) => h("li.note", { key: `note ${text}` }, colour && swatch(colour), text)),
    ];
  }
}

const swatch = (colour) => h("i.swatch", { style: `background:var(--${colour})` });
