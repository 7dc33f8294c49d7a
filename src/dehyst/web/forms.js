// Forms, which keep the typed values when they are drawn again, and lists of sentences.
import { h } from "./dom.js";
import { numberFrom } from "./numbers.js";

export class Form {
  // Fields by name: { label, value, unit, hint, placeholder }, and the type of the value: `choices` [[value, text],
  // ...], `text`, or a number `above` or at `least` a bound; `many` for several numbers; `optional` if it may be empty.
  // `changed` is called with the name of a field after each change by the user.
  constructor(id, fields, changed = () => {}) {
    Object.assign(this, { id, fields, changed });
    this.values = Object.fromEntries(Object.entries(fields).map(([name, { value = "" }]) => [name, value]));
  }

  // Fill in values, as `collected` returns them; others than those of the fields are left out.
  fill(values) {
    for (const name of Object.keys(this.fields)) if (name in values) this.values[name] = [values[name]].flat().join(" ");
  }

  // Labels and values as facts, with the placeholder for an empty value.
  rows(values) {
    const text = ({ unit = "", choices = [], placeholder }, value) =>
      value === null ? placeholder : choices.find(([own]) => own === value)?.[1] ?? `${[value].flat().join(" ")} ${unit}`;
    const asked = Object.entries(this.fields).filter(([name]) => name in values);
    return asked.map(([name, field]) => [field.label, text(field, values[name])]);
  }

  // Offer other choices. If the present value is not among them, the first is chosen.
  offer(name, choices) {
    this.fields[name].choices = choices;
    if (!choices.some(([value]) => value === this.values[name])) this.values[name] = choices[0]?.[0] ?? "";
  }

  field(name, { class: style } = {}) {
    const { label, unit, hint, choices, placeholder } = this.fields[name];
    const id = `${this.id}-${name.replaceAll("_", "-")}`;
    const change = (event) => {
      this.values[name] = event.target.value;
      this.changed(name);
    };
    const common = { id, class: style, value: this.values[name], "aria-describedby": hint && `${id}-hint` };
    const typed = { type: "text", autocomplete: "off", spellcheck: "false", placeholder, oninput: change };
    return h("div.field", { key: name },
      h("label", { for: id }, label, unit && h("span.unit", ` (${unit})`)),
      choices ? h("select", { ...common, onchange: change }, options(choices)) : h("input", { ...common, ...typed }),
      hint && h("small.hint", { id: `${id}-hint` }, hint),
    );
  }

  row(names, style = "fields") {
    return h("div", { class: style }, names.map((name) => this.field(name)));
  }

  // The value of a field, null if it is empty and optional; an Error names the field.
  value(name, optional = this.fields[name].optional) {
    const field = this.fields[name];
    const text = this.values[name].trim();
    if (field.choices || field.text) return text || null;
    if (!field.many || !text) return numberFrom(text, field.label, { ...field, optional });
    return text.split(/[\s;]+/).map((word) => numberFrom(word, field.label));
  }

  // The values of fields by name, without empty ones; `needed` fields may not be empty.
  collected(names = Object.keys(this.fields), needed = []) {
    const pairs = names.map((name) => [name, this.value(name, needed.includes(name) ? false : undefined)]);
    return Object.fromEntries(pairs.filter(([, value]) => value !== null));
  }
}

export const tick = (label, { spoken, ...input }) =>
  h("label.tick", h("input", { "aria-label": spoken, ...input }), label);

export const card = (title, { class: style = "", ...about }, ...content) =>
  h("div", { class: `card ${style}`.trim(), ...about }, h("h3", title), content);

export const options = (choices) => choices.map(([value, text]) => h("option", { value, key: value }, text));

// Names and values; a value that is undefined is left out.
export const facts = (pairs) =>
  h("dl.facts", pairs.map(([name, value]) => value !== undefined && h("div", h("dt", name), h("dd", value))));

export const list = (sentences, style) =>
  sentences?.length > 0 && h("ul", { class: style }, sentences.map((sentence) => h("li", sentence)));

export const fold = (summary, ...content) =>
  h("details", { key: `fold ${summary}` }, h("summary", summary), content);
