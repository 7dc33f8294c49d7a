// Fields that a person fills in, and buttons that act. What is typed is kept here, however often a page is drawn.
import { byId, h } from "./dom.js";
import { numberFrom } from "./numbers.js";
import { redraw } from "./state.js";

export class Form {
  // Fields by name: { label, value, unit, hint, placeholder, choices: [[value, text], ...], above, least, optional }.
  // `changed` is called after each change by the person.
  constructor(id, fields, changed = redraw) {
    Object.assign(this, { id, fields, changed });
    this.values = Object.fromEntries(Object.entries(fields).map(([name, { value = "" }]) => [name, value]));
  }

  // A labelled control.
  field(name, { class: style } = {}) {
    const { label, unit, hint, choices, placeholder } = this.fields[name];
    const id = `${this.id}-${name.replaceAll("_", "-")}`;
    const change = (event) => {
      this.values[name] = event.target.value;
      this.changed(name);
    };
    const common = { id, class: style, value: this.values[name], "aria-describedby": hint && `${id}-hint` };
    const typed = { type: "text", autocomplete: "off", spellcheck: "false", placeholder, oninput: change };
    return h(
      "div",
      { class: "field", key: name },
      h("label", { for: id }, label, unit && h("span", { class: "unit" }, ` (${unit})`)),
      choices ? h("select", { ...common, onchange: change }, options(choices)) : h("input", { ...common, ...typed }),
      hint && h("small", { class: "hint", id: `${id}-hint` }, hint),
    );
  }

  row(names, style = "fields") {
    return h("div", { class: style }, names.map((name) => this.field(name)));
  }

  // The number in a field, null if it is empty and may be; an Error names the field.
  number(name) {
    return numberFrom(this.values[name], this.fields[name].label, this.fields[name]);
  }
}

export const options = (choices) => choices.map(([value, text]) => h("option", { value, key: value }, text));

// What went wrong, by the place where it is shown; and the buttons whose work goes on.
const problems = new Map();
const busy = new Set();

export const problem = (place) =>
  problems.get(place) && h("p", { class: "error", role: "alert", key: `problem ${place}` }, problems.get(place));

export function complain(place, sentence) {
  if ((problems.get(place) ?? "") === sentence) return;
  problems.set(place, sentence);
  redraw();
}

// A button that works: it is disabled meanwhile, and an error is shown in full in its place.
export function button(text, place, work, properties = {}) {
  const key = `${place} ${text}`;
  const onclick = async () => {
    busy.add(key);
    complain(place, "");
    redraw();
    try {
      await work();
    } catch (error) {
      complain(place, error.message);
    }
    busy.delete(key);
    redraw();
  };
  return h("button", { type: "button", disabled: busy.has(key), onclick, ...properties }, text);
}

// Text for the screen reader alone.
export function announce(text) {
  byId("announcer").textContent = text;
}

export const facts = (pairs) =>
  h("dl", { class: "facts" }, pairs.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));

export const list = (sentences, style) =>
  sentences?.length > 0 && h("ul", { class: style }, sentences.map((one) => h("li", {}, one)));

export const fold = (summary, ...content) =>
  h("details", { key: `fold ${summary}` }, h("summary", {}, summary), content);
